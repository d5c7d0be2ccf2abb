/*
 * Template without an include guard: activations in one kind of jets. Define before inclusion: NUMBER, their type, and
 * OF(name), the name of a function of them.
 */

/* Replaces x by its activation, and sets the slope to the derivative. */
static void OF(activate_one)(Activation activation, NUMBER *x, NUMBER *slope)
{
    const NUMBER one = OF(constant)(R(1.0));
    const bool is_positive = OF(value)(*x) > R(0.0);
    NUMBER argument = OF(scaled)(*x, R(0.5));
    NUMBER rate = one; /* twice the derivative of the argument */
    switch (activation) {
    case ACTIVATION_IDENTITY:
        *slope = one;
        return;
    case ACTIVATION_TANH:
        *x = OF(hyperbolic_tangent)(*x);
        *slope = OF(difference)(one, OF(product)(*x, *x));
        return;
    case ACTIVATION_SINE:
        OF(sine_and_cosine)(*x, x, slope);
        return;
    case ACTIVATION_RELU:
        *x = is_positive ? *x : OF(scaled)(*x, R(0.0));
        *slope = OF(constant)(is_positive ? R(1.0) : R(0.0));
        return;
    case ACTIVATION_GELU: {
        const Real linear = R(0.7978845608028654); /* sqrt(2 / pi) */
        const NUMBER square = OF(scaled)(OF(product)(*x, *x), R(0.044715));
        argument = OF(scaled)(OF(product)(*x, OF(sum)(one, square)), linear);
        rate = OF(scaled)(OF(sum)(one, OF(scaled)(square, R(3.0))), R(2.0) * linear);
        break;
    }
    default:
        break; /* the argument is half of x */
    }
    /* s = (1 + tanh u) / 2 has the derivative 2 s (1 - s) with respect to u */
    const NUMBER share = OF(scaled)(OF(sum)(OF(hyperbolic_tangent)(argument), one), R(0.5));
    const NUMBER change = OF(product)(OF(product)(share, OF(difference)(one, share)), rate);
    *slope = activation == ACTIVATION_SIGMOID ? change : OF(sum)(share, OF(product)(*x, change));
    *x = activation == ACTIVATION_SIGMOID ? share : OF(product)(*x, share);
}

/* Replaces `count` numbers by their activations. Slopes may be null. */
static void OF(activate)(Activation activation, NUMBER *x, NUMBER *slopes, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        NUMBER slope;
        OF(activate_one)(activation, &x[i], &slope);
        if (slopes != NULL) {
            slopes[i] = slope;
        }
    }
}
