/*
 * A template, without a guard: a network that adds to functions, evaluated in one kind of numbers. Before it is
 * included, NUMBER is their type and OF(name) the name of a function of them.
 */

/* The activation of x, and its derivative. */
static void OF(activated)(TermActivation activation, NUMBER x, NUMBER *value, NUMBER *slope)
{
    const NUMBER one = OF(constant)(1.0);
    NUMBER share = x;
    *value = x;
    *slope = one;
    switch (activation) {
    case TERM_IDENTITY:
        break;
    case TERM_TANH:
        *value = OF(hyperbolic_tangent)(x);
        *slope = OF(difference)(one, OF(product)(*value, *value));
        break;
    case TERM_SIGMOID:
        share = OF(scaled)(OF(sum)(OF(hyperbolic_tangent)(OF(scaled)(x, 0.5)), one), 0.5);
        *value = share;
        *slope = OF(product)(share, OF(difference)(one, share));
        break;
    case TERM_SILU:
        share = OF(scaled)(OF(sum)(OF(hyperbolic_tangent)(OF(scaled)(x, 0.5)), one), 0.5);
        *value = OF(product)(x, share);
        *slope = OF(sum)(share, OF(product)(*value, OF(difference)(one, share)));
        break;
    case TERM_GELU: {
        const double linear = 0.7978845608028654; /* sqrt(2 / pi) */
        const NUMBER square = OF(product)(x, x);
        const NUMBER of_x = OF(product)(x, OF(sum)(OF(constant)(linear), OF(scaled)(square, 0.044715 * linear)));
        const NUMBER rate = OF(sum)(OF(constant)(linear), OF(scaled)(square, 3.0 * 0.044715 * linear));
        share = OF(scaled)(OF(sum)(OF(hyperbolic_tangent)(of_x), one), 0.5);
        *value = OF(product)(x, share);
        const NUMBER rest = OF(product)(OF(product)(*value, OF(difference)(one, share)), rate);
        *slope = OF(sum)(share, OF(scaled)(rest, 2.0));
        break;
    }
    case TERM_SINE:
        OF(sine_and_cosine)(x, value, slope);
        break;
    case TERM_RELU:
        *value = OF(value)(x) > 0.0 ? x : OF(scaled)(x, 0.0);
        *slope = OF(constant)(OF(value)(x) > 0.0 ? 1.0 : 0.0);
        break;
    }
}

/*
 * Adds to y at x and to y's derivatives with respect to the first columns, so many: gradient[output * first + column].
 * The working memory holds two layers, each with its derivatives.
 */
static void OF(add_network)(const NetworkTerm *term, const NUMBER *x, NUMBER *y, NUMBER *gradient, size_t first,
                            NUMBER *memory)
{
    NUMBER *current = memory;
    NUMBER *next = memory + (1 + first) * NETWORK_WIDTH;
    for (size_t i = 0; i < term->column_count; i++) {
        const TermColumn *column = &term->columns[i];
        NUMBER value = x[column->of];
        NUMBER slope = OF(constant)(1.0);
        if (column->kind != TERM_PLAIN) {
            NUMBER sine;
            NUMBER cosine;
            OF(sine_and_cosine)(x[column->of], &sine, &cosine);
            value = column->kind == TERM_OF_SINE ? sine : cosine;
            slope = column->kind == TERM_OF_SINE ? cosine : OF(scaled)(sine, -1.0);
        }
        current[i] = OF(scaled)(OF(difference)(value, OF(constant)(column->mean)), column->scale);
        for (size_t k = 0; k < first; k++) {
            current[(1 + k) * NETWORK_WIDTH + i] =
                column->of == k ? OF(scaled)(slope, column->scale) : OF(constant)(0.0);
        }
    }
    for (size_t l = 0; l < term->layer_count; l++) {
        const TermLayer *layer = &term->layers[l];
        for (size_t order = 0; order <= first; order++) {
            const NUMBER *from = current + order * NETWORK_WIDTH;
            NUMBER *to = next + order * NETWORK_WIDTH;
            for (size_t row = 0; row < layer->outputs; row++) {
                to[row] = OF(constant)(order == 0 ? layer->bias[row] : 0.0);
            }
            for (size_t column = 0; column < layer->inputs; column++) {
                const double *weights = layer->weights + column * layer->outputs;
                for (size_t row = 0; row < layer->outputs; row++) {
                    to[row] = OF(sum)(to[row], OF(scaled)(from[column], weights[row]));
                }
            }
        }
        for (size_t row = 0; row < layer->outputs; row++) {
            NUMBER slope;
            OF(activated)(layer->activation, next[row], &next[row], &slope);
            for (size_t k = 1; k <= first; k++) {
                NUMBER *tangent = &next[k * NETWORK_WIDTH + row];
                *tangent = OF(product)(*tangent, slope);
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
