/*
 * A function as a sequence of steps. Each step computes numbers from those before it. All numbers are in one array:
 * first the columns, then the results of each step. The outputs are the results of the last step.
 */
#ifndef GRAPH_H
#define GRAPH_H

#include "jets.h"
#include "model.h"

#if MODEL_HAS_DICTIONARY
#include "tape.h"
extern const Tape model_functions; /* its registers precede the numbers that it computes; zero before the first run */
#endif

typedef enum {
    STEP_AFFINE,      /* y = W x + b */
    STEP_ELEMENTWISE, /* y_i = f(x_i) */
    STEP_COMBINE,     /* y_i = a_i op b_i */
    STEP_SELECT,      /* y_i = a_i where c_i > 0, else b_i */
    STEP_COLUMNS,     /* y_i is any earlier number */
    STEP_STANDARDIZE, /* y_i = (x_i - mean_i) / scale_i */
    STEP_RESCALE,     /* y_i = mean_i + scale_i x_i */
    STEP_NORMALIZE,   /* y_i = (x_i - mean of x) / square root of (variance of x + epsilon) */
    STEP_SOFTMAX,     /* y_i = exp(x_i) / the sum over j of exp(x_j) */
    STEP_DISTANCES,   /* y_c = the sum over i of ((x_i - centre_ci) / length_i)^2 */
    STEP_FOREST,      /* sums of decision trees */
    STEP_PRODUCTS,    /* y_t = the product over i of P_degree_ti(x_i), with Legendre polynomials P_k */
    STEP_DICTIONARY   /* sums of products of powers, sines and cosines of x_i */
} StepKind;

typedef enum { COMBINE_ADD, COMBINE_SUBTRACT, COMBINE_MULTIPLY, COMBINE_DIVIDE, COMBINE_MAXIMUM, COMBINE_MINIMUM } Combination;

typedef struct {
    StepKind kind;
    Function function; /* of a number x, with parameters p and q */
    Combination operation;
    size_t of[3]; /* where its operands begin */
    size_t width; /* number of values of each operand */
    size_t to;    /* where its results begin */
    size_t count; /* number of results */
    /* W in blocks of rows, centers, means, or parameters: one p and one q for all numbers, or all p and then all q */
    const Real *numbers;
    size_t parameter_step; /* 0 if all numbers share the parameters, else 1 */
    const Real *more;    /* b, reciprocals of lengths, scales or their reciprocals, or epsilon */
    const size_t *places;  /* of the columns */
    size_t first_tree;
    size_t tree_count;
    const unsigned char *degrees; /* of each number in each product */
    size_t orders; /* number of polynomials of a number, degrees 0, 1, ...; the polynomials of all numbers precede the products */
} GraphStep;

/* A split tests a number. A leaf has column NO_COLUMN. */
typedef struct {
    size_t column;
    Real number;   /* threshold: numbers up to it go to the first node below, others to the second; or the leaf's value */
    size_t below[2]; /* both come after this node, so that a walk ends */
} GraphNode;

#define NO_COLUMN ((size_t)-1)

typedef struct {
    size_t root;
    size_t output;
} GraphTree;

extern const GraphStep model_steps[STEP_COUNT];
extern const GraphNode model_graph_nodes[];
extern const GraphTree model_graph_trees[];

/* Computes the results of all steps from the columns, which are the first numbers. The outputs are the last ones. */
void real_graph(Real numbers[NUMBER_COUNT]);
void jet_graph(Jet numbers[NUMBER_COUNT]);

#if MODEL_HAS_MAPS

/* Working memory of one evaluation at a time. */
typedef struct {
    Real real[NUMBER_COUNT];
    Jet jet[NUMBER_COUNT];
} MapScratch;

#endif

#endif
