/*
 * A template, without a guard: activations in one kind of jets. Before it is included, NUMBER is their type and
 * OF(name) the name of a function of them.
 */

/* The activation of x, and its derivative. */
static void OF(activated)(Activation activation, NUMBER x, NUMBER *value, NUMBER *slope)
{
    const NUMBER one = OF(constant)(R(1.0));
    NUMBER share = x;
    *value = x;
    *slope = one;
    switch (activation) {
    case ACTIVATION_IDENTITY:
        break;
    case ACTIVATION_TANH:
        *value = OF(hyperbolic_tangent)(x);
        *slope = OF(difference)(one, OF(product)(*value, *value));
        break;
    case ACTIVATION_SIGMOID:
        share = OF(scaled)(OF(sum)(OF(hyperbolic_tangent)(OF(scaled)(x, R(0.5))), one), R(0.5));
        *value = share;
        *slope = OF(product)(share, OF(difference)(one, share));
        break;
    case ACTIVATION_SILU:
        share = OF(scaled)(OF(sum)(OF(hyperbolic_tangent)(OF(scaled)(x, R(0.5))), one), R(0.5));
        *value = OF(product)(x, share);
        *slope = OF(sum)(share, OF(product)(*value, OF(difference)(one, share)));
        break;
    case ACTIVATION_GELU: {
        const Real linear = R(0.7978845608028654); /* sqrt(2 / pi) */
        const NUMBER square = OF(product)(x, x);
        const NUMBER of_x = OF(product)(x, OF(sum)(OF(constant)(linear), OF(scaled)(square, R(0.044715) * linear)));
        const NUMBER rate = OF(sum)(OF(constant)(linear), OF(scaled)(square, R(3.0) * R(0.044715) * linear));
        share = OF(scaled)(OF(sum)(OF(hyperbolic_tangent)(of_x), one), R(0.5));
        *value = OF(product)(x, share);
        const NUMBER rest = OF(product)(OF(product)(*value, OF(difference)(one, share)), rate);
        *slope = OF(sum)(share, OF(scaled)(rest, R(2.0)));
        break;
    }
    case ACTIVATION_SINE:
        OF(sine_and_cosine)(x, value, slope);
        break;
    case ACTIVATION_RELU:
        *value = OF(value)(x) > R(0.0) ? x : OF(scaled)(x, R(0.0));
        *slope = OF(constant)(OF(value)(x) > R(0.0) ? R(1.0) : R(0.0));
        break;
    }
}

/* x becomes the activation of x, and unless the pointer is null, their slopes go there: so many numbers. */
static void OF(activate)(Activation activation, NUMBER *x, NUMBER *slopes, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        NUMBER slope;
        OF(activated)(activation, x[i], &x[i], &slope);
        if (slopes != NULL) {
            slopes[i] = slope;
        }
    }
}
