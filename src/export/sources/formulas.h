/*
 * Functions that formulas of efforts call, in real numbers and in jets. A jet that does not change has no derivative,
 * even where that of the function is infinite, as of the square root at zero.
 */
#ifndef FORMULAS_H
#define FORMULAS_H

#include "jets.h"

/* A function of a jet from its value, slope and curvature. */
static inline Jet jet_chain(Jet a, Real value, Real slope, Real curvature)
{
    const Real square = a.first * a.first;
    const Real first = a.first < R(0.0) || a.first > R(0.0) ? slope * a.first : R(0.0);
    const Real bent = square > R(0.0) ? curvature * square : R(0.0);
    const Real second = a.second < R(0.0) || a.second > R(0.0) ? slope * a.second : R(0.0);
    return (Jet){value, first, bent + second};
}

static inline Real real_sin(Real a)
{
    return MATH(sin)(a);
}

static inline Jet jet_sin(Jet a)
{
    const Real value = MATH(sin)(a.value);
    return jet_chain(a, value, MATH(cos)(a.value), -value);
}

static inline Real real_cos(Real a)
{
    return MATH(cos)(a);
}

static inline Jet jet_cos(Jet a)
{
    const Real value = MATH(cos)(a.value);
    return jet_chain(a, value, -MATH(sin)(a.value), -value);
}

static inline Real real_tan(Real a)
{
    return MATH(tan)(a);
}

static inline Jet jet_tan(Jet a)
{
    const Real value = MATH(tan)(a.value);
    const Real slope = R(1.0) + value * value;
    return jet_chain(a, value, slope, R(2.0) * value * slope);
}

static inline Real real_asin(Real a)
{
    return MATH(asin)(a);
}

static inline Jet jet_asin(Jet a)
{
    const Real slope = R(1.0) / MATH(sqrt)(R(1.0) - a.value * a.value);
    return jet_chain(a, MATH(asin)(a.value), slope, a.value * (slope * slope * slope));
}

static inline Real real_acos(Real a)
{
    return MATH(acos)(a);
}

static inline Jet jet_acos(Jet a)
{
    const Real slope = R(1.0) / MATH(sqrt)(R(1.0) - a.value * a.value);
    return jet_chain(a, MATH(acos)(a.value), -slope, -a.value * (slope * slope * slope));
}

static inline Real real_atan(Real a)
{
    return MATH(atan)(a);
}

static inline Jet jet_atan(Jet a)
{
    const Real slope = R(1.0) / (R(1.0) + a.value * a.value);
    return jet_chain(a, MATH(atan)(a.value), slope, R(-2.0) * a.value * slope * slope);
}

static inline Real real_tanh(Real a)
{
    return MATH(tanh)(a);
}

static inline Jet jet_tanh(Jet a)
{
    const Real value = MATH(tanh)(a.value);
    const Real slope = R(1.0) - value * value;
    return jet_chain(a, value, slope, R(-2.0) * value * slope);
}

static inline Real real_exp(Real a)
{
    return MATH(exp)(a);
}

static inline Jet jet_exp(Jet a)
{
    const Real value = MATH(exp)(a.value);
    return jet_chain(a, value, value, value);
}

static inline Real real_ln(Real a)
{
    return MATH(log)(a);
}

static inline Jet jet_ln(Jet a)
{
    return jet_chain(a, MATH(log)(a.value), R(1.0) / a.value, R(-1.0) / (a.value * a.value));
}

static inline Real real_sqrt(Real a)
{
    return MATH(sqrt)(a);
}

static inline Jet jet_sqrt(Jet a)
{
    const Real value = MATH(sqrt)(a.value);
    return jet_chain(a, value, R(0.5) / value, R(-0.25) / (a.value * value));
}

static inline Real real_abs(Real a)
{
    return MATH(fabs)(a);
}

static inline Jet jet_abs(Jet a)
{
    return jet_chain(a, MATH(fabs)(a.value), a.value < R(0.0) ? R(-1.0) : R(1.0), R(0.0));
}

static inline Real real_sign(Real a)
{
    if (a > R(0.0)) {
        return R(1.0);
    }
    return a < R(0.0) ? R(-1.0) : a;
}

static inline Jet jet_sign(Jet a)
{
    return jet_constant(real_sign(a.value));
}

static inline Real real_minimum(Real a, Real b)
{
    return b < a || isnan(b) ? b : a;
}

static inline Jet jet_minimum(Jet a, Jet b)
{
    return b.value < a.value || isnan(b.value) ? b : a;
}

static inline Real real_maximum(Real a, Real b)
{
    return b > a || isnan(b) ? b : a;
}

static inline Jet jet_maximum(Jet a, Jet b)
{
    return b.value > a.value || isnan(b.value) ? b : a;
}

static inline Real real_quotient(Real a, Real b)
{
    return a / b;
}

static inline Jet jet_quotient(Jet a, Jet b)
{
    const Real x = b.value;
    const Jet inverse = jet_chain(b, R(1.0) / x, R(-1.0) / (x * x), R(2.0) / (x * x * x));
    Jet quotient = jet_product(a, inverse);
    quotient.value = a.value / x;
    return quotient;
}

static inline Real real_power(Real a, Real b)
{
    return MATH(pow)(a, b);
}

/* A factor times a power of x, zero if the factor is. */
static inline Real real_term(Real factor, Real x, Real power)
{
    return factor < R(0.0) || factor > R(0.0) ? factor * MATH(pow)(x, power) : R(0.0);
}

static inline Jet jet_power(Jet a, Jet b)
{
    const Real value = MATH(pow)(a.value, b.value);
    const int changes = MATH(fabs)(b.first) > R(0.0) || MATH(fabs)(b.second) > R(0.0);
    /* at zero a power vanishes whatever its exponent is */
    if (changes && !(MATH(fabs)(a.value) <= R(0.0) && b.value > R(0.0))) {
        return jet_chain(jet_product(b, jet_ln(a)), value, value, value);
    }
    const Real p = b.value;
    const Real slope = real_term(p, a.value, p - R(1.0));
    return jet_chain(a, value, slope, real_term(p * (p - R(1.0)), a.value, p - R(2.0)));
}

#endif
