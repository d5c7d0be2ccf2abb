/*
 * A template, without a guard: a network that adds to functions, evaluated in one kind of numbers. Before it is
 * included, NUMBER is their type, OF(name) the name of a function of them, and there is OF(activate).
 */

/* y = W x, and the bias if it counts. */
static CLONED void OF(multiply)(const TermLayer *layer, const NUMBER *x, NUMBER *y, bool biased)
{
    for (size_t block = 0; block < layer->rows; block += BLOCK) {
        const Real *weights = layer->weights + block * layer->inputs;
        NUMBER sums[BLOCK];
        for (size_t row = 0; row < BLOCK; row++) {
            sums[row] = OF(constant)(biased ? layer->bias[block + row] : R(0.0));
        }
        size_t column = 0;
        for (; column + GROUP <= layer->inputs; column += GROUP) {
            const Real *w = weights + column * BLOCK;
            for (size_t row = 0; row < BLOCK; row++) {
                const NUMBER a = OF(scaled)(x[column], w[row]);
                const NUMBER b = OF(scaled)(x[column + 1], w[BLOCK + row]);
                const NUMBER c = OF(scaled)(x[column + 2], w[2 * BLOCK + row]);
                const NUMBER d = OF(scaled)(x[column + 3], w[3 * BLOCK + row]);
                sums[row] = OF(sum)(sums[row], OF(sum)(OF(sum)(a, b), OF(sum)(c, d)));
            }
        }
        for (; column < layer->inputs; column++) {
            for (size_t row = 0; row < BLOCK; row++) {
                sums[row] = OF(sum)(sums[row], OF(scaled)(x[column], weights[column * BLOCK + row]));
            }
        }
        for (size_t row = 0; row < BLOCK; row++) {
            y[block + row] = sums[row];
        }
    }
}

/*
 * Adds to y at x and to y's derivatives with respect to the first columns, so many: gradient[output * first + column].
 * The working memory holds two layers, each with its derivatives, and with derivatives the slopes of one.
 */
static void OF(add_network)(const NetworkTerm *term, const NUMBER *x, NUMBER *y, NUMBER *gradient, size_t first,
                            NUMBER *memory)
{
    NUMBER *current = memory;
    NUMBER *next = memory + (1 + first) * NETWORK_WIDTH;
    NUMBER *slopes = first == 0 ? NULL : memory + 2 * (1 + first) * NETWORK_WIDTH;
    for (size_t i = 0; i < term->column_count; i++) {
        const TermColumn *column = &term->columns[i];
        NUMBER value = x[column->of];
        NUMBER slope = OF(constant)(R(1.0));
        if (column->kind != TERM_PLAIN) {
            NUMBER sine;
            NUMBER cosine;
            OF(sine_and_cosine)(x[column->of], &sine, &cosine);
            value = column->kind == TERM_OF_SINE ? sine : cosine;
            slope = column->kind == TERM_OF_SINE ? cosine : OF(scaled)(sine, -R(1.0));
        }
        current[i] = OF(scaled)(OF(difference)(value, OF(constant)(column->mean)), column->scale);
        for (size_t k = 0; k < first; k++) {
            current[(1 + k) * NETWORK_WIDTH + i] =
                column->of == k ? OF(scaled)(slope, column->scale) : OF(constant)(R(0.0));
        }
    }
    for (size_t l = 0; l < term->layer_count; l++) {
        const TermLayer *layer = &term->layers[l];
        for (size_t order = 0; order <= first; order++) {
            OF(multiply)(layer, current + order * NETWORK_WIDTH, next + order * NETWORK_WIDTH, order == 0);
        }
        if (layer->activation != ACTIVATION_IDENTITY) {
            OF(activate)(layer->activation, next, slopes, layer->rows);
            for (size_t k = 1; k <= first; k++) {
                NUMBER *tangents = next + k * NETWORK_WIDTH;
                for (size_t row = 0; row < layer->rows; row++) {
                    tangents[row] = OF(product)(tangents[row], slopes[row]);
                }
            }
        }
        NUMBER *const before = current;
        current = next;
        next = before;
    }
    for (size_t i = 0; i < term->output_count; i++) {
        const TermOutput *output = &term->outputs[i];
        const NUMBER value = OF(sum)(OF(scaled)(current[i], output->scale), OF(constant)(output->mean));
        y[output->of] = OF(sum)(y[output->of], value);
        for (size_t k = 0; k < first; k++) {
            NUMBER *to = &gradient[output->of * first + k];
            *to = OF(sum)(*to, OF(scaled)(current[(1 + k) * NETWORK_WIDTH + i], output->scale));
        }
    }
}
