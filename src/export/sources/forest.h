/*
 * A template: sums of decision trees in one kind of numbers. Before it is included, NUMBER is their type and OF(name)
 * the name of a function of them; without them it has the declarations.
 *
 * An output is the sum of the leaves that its trees lead to: piecewise constant, so that every derivative is zero. It
 * takes an addition for a tree, besides as many comparisons as the tree has levels of splits at worst.
 */

#ifndef NUMBER

/* A split looks at a column; a leaf has none, which is MAP_COLUMNS. */
typedef struct {
    size_t column;
    Real number;   /* columns up to this one go to the first node below, others to the second; or the leaf's value */
    size_t below[2]; /* behind this one, so that a walk ends */
} Node;

typedef struct {
    size_t root;
    size_t output;
} Tree;

extern const size_t model_tree_count;
extern const Node model_nodes[];
extern const Tree model_trees[];

#else /* the template */

static void OF(function)(const NUMBER z[MAP_COLUMNS], NUMBER y[OUTPUT_COUNT], NUMBER table[TABLE_SIZE])
{
    (void)table;
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        y[i] = OF(constant)(R(0.0));
    }
    for (size_t i = 0; i < model_tree_count; i++) {
        const Tree *tree = &model_trees[i];
        const Node *node = &model_nodes[tree->root];
        while (node->column < MAP_COLUMNS) {
            node = &model_nodes[node->below[OF(value)(z[node->column]) <= node->number ? 0 : 1]];
        }
        y[tree->output] = OF(sum)(y[tree->output], OF(constant)(node->number));
    }
}

#endif
