/*
 * Template: the steps of a graph in one kind of numbers. Define before inclusion: NUMBER, their type, and OF(name), the
 * name of a function of them.
 */

static void OF(elementwise)(const GraphStep *step, const NUMBER x[], NUMBER y[])
{
    if (is_in_blocks(step->function)) {
        OF(activations)(step, x, y);
        return;
    }
    const Real *p = step->numbers;
    /* all second parameters follow all first ones */
    const Real *q = step->parameter_step == 0 ? p + 1 : p + step->count;
    for (size_t i = 0; i < step->count; i++) {
        const size_t place = i * step->parameter_step;
        y[i] = OF(through)(x[i], series(step->function, OF(value)(x[i]), p[place], q[place]));
    }
}

static NUMBER OF(combined)(Combination operation, NUMBER a, NUMBER b)
{
    switch (operation) {
    case COMBINE_ADD:
        return OF(sum)(a, b);
    case COMBINE_SUBTRACT:
        return OF(difference)(a, b);
    case COMBINE_MULTIPLY:
        return OF(product)(a, b);
    case COMBINE_DIVIDE:
        return OF(product)(a, OF(reciprocal)(b));
    case COMBINE_MAXIMUM:
        return OF(value)(b) > OF(value)(a) ? b : a;
    case COMBINE_MINIMUM:
    default:
        return OF(value)(b) < OF(value)(a) ? b : a;
    }
}

/* Adds numbers of residual connections. Loops of a constant length come first: they become SIMD code even at -O2. */
static CLONED void OF(add)(size_t count, const NUMBER *a, const NUMBER *b, NUMBER *restrict y)
{
    size_t i = 0;
    for (; i + BLOCK <= count; i += BLOCK) {
        for (size_t k = 0; k < BLOCK; k++) {
            y[i + k] = OF(sum)(a[i + k], b[i + k]);
        }
    }
    for (; i < count; i++) {
        y[i] = OF(sum)(a[i], b[i]);
    }
}

static void OF(combine)(const GraphStep *step, const NUMBER a[], const NUMBER b[], NUMBER y[])
{
    if (step->operation == COMBINE_ADD) {
        OF(add)(step->count, a, b, y);
        return;
    }
    for (size_t i = 0; i < step->count; i++) {
        y[i] = OF(combined)(step->operation, a[i], b[i]);
    }
}

static void OF(standardize)(const GraphStep *step, const NUMBER x[], NUMBER y[])
{
    for (size_t i = 0; i < step->count; i++) {
        y[i] = OF(scaled)(OF(difference)(x[i], OF(constant)(step->numbers[i])), step->more[i]);
    }
}

static void OF(rescale)(const GraphStep *step, const NUMBER x[], NUMBER y[])
{
    for (size_t i = 0; i < step->count; i++) {
        y[i] = OF(sum)(OF(constant)(step->numbers[i]), OF(scaled)(x[i], step->more[i]));
    }
}

static void OF(normalize)(const GraphStep *step, const NUMBER x[], NUMBER y[])
{
    const Real share = R(1.0) / (Real)step->width;
    NUMBER mean = OF(constant)(R(0.0));
    NUMBER variance = OF(constant)(R(0.0));
    for (size_t i = 0; i < step->width; i++) {
        mean = OF(sum)(mean, x[i]);
    }
    mean = OF(scaled)(mean, share);
    for (size_t i = 0; i < step->width; i++) {
        const NUMBER away = OF(difference)(x[i], mean);
        variance = OF(sum)(variance, OF(product)(away, away));
    }
    variance = OF(sum)(OF(scaled)(variance, share), OF(constant)(step->more[0]));
    const NUMBER inverse = OF(through)(variance, series(FUNCTION_POWER, OF(value)(variance), -R(0.5), R(0.0)));
    for (size_t i = 0; i < step->width; i++) {
        y[i] = OF(product)(OF(difference)(x[i], mean), inverse);
    }
}

static void OF(softmax)(const GraphStep *step, const NUMBER x[], NUMBER y[])
{
    /* subtracted from all numbers, so that nothing overflows */
    Real largest = OF(value)(x[0]);
    NUMBER sum = OF(constant)(R(0.0));
    for (size_t i = 1; i < step->width; i++) {
        largest = OF(value)(x[i]) > largest ? OF(value)(x[i]) : largest;
    }
    for (size_t i = 0; i < step->width; i++) {
        y[i] = OF(exponential)(OF(difference)(x[i], OF(constant)(largest)));
        sum = OF(sum)(sum, y[i]);
    }
    const NUMBER inverse = OF(reciprocal)(sum);
    for (size_t i = 0; i < step->width; i++) {
        y[i] = OF(product)(y[i], inverse);
    }
}

static void OF(distances)(const GraphStep *step, const NUMBER x[], NUMBER y[])
{
    const Real *centre = step->numbers;
    for (size_t c = 0; c < step->count; c++) {
        y[c] = OF(constant)(R(0.0));
        for (size_t i = 0; i < step->width; i++) {
            const NUMBER away = OF(scaled)(OF(difference)(x[i], OF(constant)(centre[i])), step->more[i]);
            y[c] = OF(sum)(y[c], OF(product)(away, away));
        }
        centre += step->width;
    }
}

/* Returns the product of x and a row of W, whose numbers are `apart` positions apart; four at a time, as in blocks.h. */
static INLINED NUMBER OF(row_by)(const Real *row, size_t apart, size_t columns, const NUMBER *x)
{
    NUMBER sum = OF(constant)(R(0.0));
    size_t k = 0;
    for (; k + 4 <= columns; k += 4) {
        const Real *w = row + k * apart;
        const NUMBER a = OF(sum)(OF(scaled)(x[k], w[0]), OF(scaled)(x[k + 1], w[apart]));
        const NUMBER b = OF(sum)(OF(scaled)(x[k + 2], w[2 * apart]), OF(scaled)(x[k + 3], w[3 * apart]));
        sum = OF(sum)(sum, OF(sum)(a, b));
    }
    for (; k < columns; k++) {
        sum = OF(sum)(sum, OF(scaled)(x[k], row[k * apart]));
    }
    return sum;
}

/* The rows of W are in blocks; the last block may have fewer. */
static CLONED void OF(affine)(const GraphStep *step, const NUMBER *restrict x, NUMBER *restrict y)
{
    const Real *weights = step->numbers;
    const Real *bias = step->more;
    const size_t rest = step->count % BLOCK;
    const size_t whole = step->count - rest;
    for (size_t first = 0; first < whole; first += BLOCK) {
        for (size_t i = 0; i < BLOCK; i++) {
            y[first + i] = OF(constant)(bias[first + i]);
        }
        OF(add_block)(weights + first * step->width, step->width, x, y + first);
    }
    weights += whole * step->width;
    for (size_t row = 0; row < rest; row++) {
        y[whole + row] = OF(sum)(OF(constant)(bias[whole + row]), OF(row_by)(weights + row, rest, step->width, x));
    }
}

static void OF(forest)(const GraphStep *step, const NUMBER x[], NUMBER y[])
{
    for (size_t i = 0; i < step->count; i++) {
        y[i] = OF(constant)(R(0.0));
    }
    for (size_t i = 0; i < step->tree_count; i++) {
        const GraphTree *tree = &model_graph_trees[step->first_tree + i];
        const GraphNode *node = &model_graph_nodes[tree->root];
        while (node->column != NO_COLUMN) {
            node = &model_graph_nodes[node->below[OF(value)(x[node->column]) <= node->number ? 0 : 1]];
        }
        y[tree->output] = OF(sum)(y[tree->output], OF(constant)(node->number));
    }
}

/* Bonnet's recursion: (k + 1) P_(k + 1) = (2 k + 1) x P_k - k P_(k - 1). */
static void OF(legendre)(NUMBER x, NUMBER values[], size_t orders)
{
    values[0] = OF(constant)(R(1.0));
    for (size_t order = 1; order < orders; order++) {
        const Real k = (Real)order - R(1.0);
        values[order] = x;
        if (order > 1) {
            const NUMBER by_x = OF(product)(OF(scaled)(x, (R(2.0) * k + R(1.0)) / (Real)order), values[order - 1]);
            values[order] = OF(difference)(by_x, OF(scaled)(values[order - 2], k / (Real)order));
        }
    }
}

static void OF(products)(const GraphStep *step, const NUMBER x[], NUMBER y[])
{
    NUMBER *polynomials = y - step->width * step->orders;
    const unsigned char *degree = step->degrees;
    for (size_t i = 0; i < step->width; i++) {
        OF(legendre)(x[i], &polynomials[i * step->orders], step->orders);
    }
    for (size_t term = 0; term < step->count; term++) {
        y[term] = OF(constant)(R(1.0));
        for (size_t i = 0; i < step->width; i++, degree++) {
            if (*degree > 0) {
                y[term] = OF(product)(y[term], polynomials[i * step->orders + *degree]);
            }
        }
    }
}

/* Computes the results of all steps from the columns, which are the first numbers. */
void OF(graph)(NUMBER numbers[NUMBER_COUNT])
{
    for (size_t k = 0; k < STEP_COUNT; k++) {
        const GraphStep *step = &model_steps[k];
        const NUMBER *x = &numbers[step->of[0]];
        const NUMBER *second = &numbers[step->of[1]];
        const NUMBER *third = &numbers[step->of[2]];
        NUMBER *y = &numbers[step->to];
        switch (step->kind) {
        case STEP_AFFINE:
            OF(affine)(step, x, y);
            break;
        case STEP_ELEMENTWISE:
            OF(elementwise)(step, x, y);
            break;
        case STEP_COMBINE:
            OF(combine)(step, x, second, y);
            break;
        case STEP_SELECT:
            for (size_t i = 0; i < step->count; i++) {
                y[i] = OF(value)(x[i]) > R(0.0) ? second[i] : third[i];
            }
            break;
        case STEP_COLUMNS:
            for (size_t i = 0; i < step->count; i++) {
                y[i] = numbers[step->places[i]];
            }
            break;
        case STEP_STANDARDIZE:
            OF(standardize)(step, x, y);
            break;
        case STEP_RESCALE:
            OF(rescale)(step, x, y);
            break;
        case STEP_NORMALIZE:
            OF(normalize)(step, x, y);
            break;
        case STEP_SOFTMAX:
            OF(softmax)(step, x, y);
            break;
        case STEP_DISTANCES:
            OF(distances)(step, x, y);
            break;
        case STEP_FOREST:
            OF(forest)(step, x, y);
            break;
        case STEP_PRODUCTS:
            OF(products)(step, x, y);
            break;
        case STEP_DICTIONARY:
#if MODEL_HAS_DICTIONARY
            OF(run)(&model_functions, x, y - FUNCTION_REGISTERS);
            for (size_t i = 0; i < step->count; i++) {
                y[i] = y[(ptrdiff_t)model_functions.results[i] - FUNCTION_REGISTERS];
            }
#endif
            break;
        }
    }
}
