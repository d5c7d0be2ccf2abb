/*
 * Numbers that carry their derivatives: a formula, written once, gives values and exact derivatives along a curve.
 * There are real numbers, jets of them, and jets of jets, which carry the change of derivatives along the motion in a
 * direction. The prefix of each function names its kind of numbers.
 */
#ifndef JETS_H
#define JETS_H

#include "clones.h"
#include "real.h"
#include <stdbool.h>

/* A value with its first and second derivatives. */
typedef struct {
    Real value;
    Real first;
    Real second;
} Jet;

typedef struct {
    Jet value;
    Jet first;
    Jet second;
} Nested;

/* ---- Real numbers ---- */

static INLINED Real real_constant(Real value)
{
    return value;
}

static INLINED Real real_value(Real a)
{
    return a;
}

/* The first of a number's value and derivatives that is not zero: its sign is the number's an instant later. */
static INLINED Real real_leading(Real a)
{
    return a;
}

static INLINED Real real_sum(Real a, Real b)
{
    return a + b;
}

static INLINED Real real_difference(Real a, Real b)
{
    return a - b;
}

static INLINED Real real_product(Real a, Real b)
{
    return a * b;
}

static INLINED Real real_scaled(Real a, Real by)
{
    return by * a;
}

static inline Real real_reciprocal(Real a)
{
    return R(1.0) / a;
}

static inline Real real_exponential(Real a)
{
    return MATH(exp)(a);
}

static inline void real_sine_and_cosine(Real a, Real *sine, Real *cosine)
{
    *sine = MATH(sin)(a);
    *cosine = MATH(cos)(a);
}

static inline Real real_hyperbolic_tangent(Real a)
{
    return MATH(tanh)(a);
}

/* ---- Jets ---- */

#define NUMBER Jet
#define OF(name) jet_##name
#define PART Real
#define OF_PART(name) real_##name
#include "jet_arithmetic.h"
#undef NUMBER
#undef OF
#undef PART
#undef OF_PART

static INLINED Real jet_value(Jet a)
{
    return a.value;
}

static INLINED bool is_zero(Real a)
{
    return a >= R(0.0) && a <= R(0.0);
}

static INLINED Real jet_leading(Jet a)
{
    if (is_zero(a.value)) {
        return is_zero(a.first) ? a.second : a.first;
    }
    return a.value;
}

static inline Jet jet_reciprocal(Jet a)
{
    const Real value = R(1.0) / a.value;
    const Real slope = -(value * value);
    return (Jet){value, slope * a.first, slope * (a.second - R(2.0) * (value * a.first * a.first))};
}

static inline Jet jet_exponential(Jet a)
{
    const Real value = MATH(exp)(a.value);
    return (Jet){value, value * a.first, value * (a.second + a.first * a.first)};
}

static inline void jet_sine_and_cosine(Jet a, Jet *sine, Jet *cosine)
{
    const Real s = MATH(sin)(a.value);
    const Real c = MATH(cos)(a.value);
    *sine = (Jet){s, c * a.first, c * a.second - s * a.first * a.first};
    *cosine = (Jet){c, -s * a.first, -s * a.second - c * a.first * a.first};
}

static inline Jet jet_hyperbolic_tangent(Jet a)
{
    const Real value = MATH(tanh)(a.value);
    const Real slope = R(1.0) - value * value;
    return (Jet){value, slope * a.first, slope * (a.second - R(2.0) * (value * a.first * a.first))};
}

static INLINED Jet jet_positive_part(Jet a, Jet *slope)
{
    const bool is_positive = a.value > R(0.0);
    *slope = jet_constant(is_positive ? R(1.0) : R(0.0));
    return is_positive ? a : jet_scaled(a, R(0.0));
}

/* ---- Jets of jets ---- */

#define NUMBER Nested
#define OF(name) nested_##name
#define PART Jet
#define OF_PART(name) jet_##name
#include "jet_arithmetic.h"
#undef NUMBER
#undef OF
#undef PART
#undef OF_PART

static INLINED Real nested_value(Nested a)
{
    return a.value.value;
}

static inline void nested_sine_and_cosine(Nested a, Nested *sine, Nested *cosine)
{
    Jet s;
    Jet c;
    jet_sine_and_cosine(a.value, &s, &c);
    const Jet bent_sine = jet_product(jet_product(s, a.first), a.first);
    const Jet bent_cosine = jet_product(jet_product(c, a.first), a.first);
    const Jet down = jet_scaled(s, -R(1.0));
    *sine = (Nested){s, jet_product(c, a.first), jet_difference(jet_product(c, a.second), bent_sine)};
    *cosine = (Nested){c, jet_product(down, a.first), jet_difference(jet_product(down, a.second), bent_cosine)};
}

static inline Nested nested_hyperbolic_tangent(Nested a)
{
    const Jet value = jet_hyperbolic_tangent(a.value);
    const Jet slope = jet_difference(jet_constant(R(1.0)), jet_product(value, value));
    const Jet bent = jet_product(jet_product(value, a.first), a.first);
    return (Nested){value, jet_product(slope, a.first),
                    jet_product(slope, jet_difference(a.second, jet_scaled(bent, R(2.0))))};
}

static INLINED Nested nested_positive_part(Nested a, Nested *slope)
{
    const bool is_positive = nested_value(a) > R(0.0);
    *slope = nested_constant(is_positive ? R(1.0) : R(0.0));
    return is_positive ? a : nested_scaled(a, R(0.0));
}

#endif
