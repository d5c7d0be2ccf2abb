/*
 * Template without an include guard: formulas of the activations and their slopes, for jets and for blocks of real
 * numbers. Define before inclusion: NUMBER, their type, and OF(name), the name of a function of them.
 */

/* Returns (1 + tanh u) / 2, whose derivative with respect to u is 2 s (1 - s). */
static INLINED NUMBER OF(share)(NUMBER u)
{
    return OF(scaled)(OF(sum)(OF(hyperbolic_tangent)(u), OF(constant)(R(1.0))), R(0.5));
}

/* Replaces x by its activation, and sets the slope to the derivative. */
static INLINED void OF(activate_one)(Activation activation, NUMBER *x, NUMBER *slope)
{
    const Real gelu_linear = R(0.7978845608028654);  /* sqrt(2 / pi) */
    const Real gelu_cubic = R(0.03567740813630013); /* 0.044715 sqrt(2 / pi) */
    const NUMBER one = OF(constant)(R(1.0));
    const NUMBER z = *x;
    switch (activation) {
    case ACTIVATION_TANH:
        *x = OF(hyperbolic_tangent)(z);
        *slope = OF(difference)(one, OF(product)(*x, *x));
        break;
    case ACTIVATION_SIGMOID:
        *x = OF(share)(OF(scaled)(z, R(0.5)));
        *slope = OF(product)(*x, OF(difference)(one, *x));
        break;
    case ACTIVATION_RELU:
        *x = OF(positive_part)(z, slope);
        break;
    case ACTIVATION_GELU: {
        const NUMBER square = OF(product)(z, z);
        const NUMBER linear = OF(constant)(gelu_linear);
        const NUMBER rate = OF(sum)(OF(scaled)(square, R(3.0) * gelu_cubic), linear); /* of the argument */
        const NUMBER s = OF(share)(OF(product)(z, OF(sum)(OF(scaled)(square, gelu_cubic), linear)));
        const NUMBER change = OF(scaled)(OF(product)(OF(product)(s, OF(difference)(one, s)), rate), R(2.0));
        *x = OF(product)(z, s);
        *slope = OF(sum)(s, OF(product)(z, change));
        break;
    }
    case ACTIVATION_SILU: {
        const NUMBER s = OF(share)(OF(scaled)(z, R(0.5)));
        *x = OF(product)(z, s);
        *slope = OF(sum)(s, OF(product)(*x, OF(difference)(one, s)));
        break;
    }
    case ACTIVATION_SINE:
        OF(sine_and_cosine)(z, x, slope);
        break;
    case ACTIVATION_IDENTITY:
    default:
        *slope = one;
        break;
    }
}

/* Replaces `count` numbers by their activations. Slopes may be null. */
static inline void OF(activate)(Activation activation, NUMBER *x, NUMBER *slopes, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        NUMBER slope;
        OF(activate_one)(activation, &x[i], &slope);
        if (slopes != NULL) {
            slopes[i] = slope;
        }
    }
}
