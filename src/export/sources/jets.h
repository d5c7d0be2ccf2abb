/*
 * Numbers that carry their derivatives: a formula that is written once gives values, and
 * exact derivatives along a curve. There are real numbers, jets of them, and jets of jets, which carry how the
 * derivatives along the motion change in a direction. Each function has the kind of its numbers in its name.
 */
#ifndef JETS_H
#define JETS_H

#include <math.h>

/* A value with its first and second derivative. */
typedef struct {
    double value;
    double first;
    double second;
} Jet;

typedef struct {
    Jet value;
    Jet first;
    Jet second;
} Nested;

/* ---- Real numbers ---- */

static inline double real_constant(double value)
{
    return value;
}

static inline double real_value(double a)
{
    return a;
}

static inline double real_sum(double a, double b)
{
    return a + b;
}

static inline double real_difference(double a, double b)
{
    return a - b;
}

static inline double real_product(double a, double b)
{
    return a * b;
}

static inline double real_scaled(double a, double by)
{
    return by * a;
}

static inline double real_reciprocal(double a)
{
    return 1.0 / a;
}

static inline double real_exponential(double a)
{
    return exp(a);
}

static inline void real_sine_and_cosine(double a, double *sine, double *cosine)
{
    *sine = sin(a);
    *cosine = cos(a);
}

static inline double real_hyperbolic_tangent(double a)
{
    return tanh(a);
}

/* ---- Jets ---- */

static inline Jet jet_constant(double value)
{
    return (Jet){value, 0.0, 0.0};
}

static inline double jet_value(Jet a)
{
    return a.value;
}

static inline Jet jet_sum(Jet a, Jet b)
{
    return (Jet){a.value + b.value, a.first + b.first, a.second + b.second};
}

static inline Jet jet_difference(Jet a, Jet b)
{
    return (Jet){a.value - b.value, a.first - b.first, a.second - b.second};
}

static inline Jet jet_product(Jet a, Jet b)
{
    return (Jet){a.value * b.value, a.first * b.value + a.value * b.first,
                 a.second * b.value + 2.0 * (a.first * b.first) + a.value * b.second};
}

static inline Jet jet_scaled(Jet a, double by)
{
    return (Jet){by * a.value, by * a.first, by * a.second};
}

static inline Jet jet_reciprocal(Jet a)
{
    const double value = 1.0 / a.value;
    const double slope = -(value * value);
    return (Jet){value, slope * a.first, slope * (a.second - 2.0 * (value * a.first * a.first))};
}

static inline Jet jet_exponential(Jet a)
{
    const double value = exp(a.value);
    return (Jet){value, value * a.first, value * (a.second + a.first * a.first)};
}

static inline void jet_sine_and_cosine(Jet a, Jet *sine, Jet *cosine)
{
    const double s = sin(a.value);
    const double c = cos(a.value);
    *sine = (Jet){s, c * a.first, c * a.second - s * a.first * a.first};
    *cosine = (Jet){c, -s * a.first, -s * a.second - c * a.first * a.first};
}

static inline Jet jet_hyperbolic_tangent(Jet a)
{
    const double value = tanh(a.value);
    const double slope = 1.0 - value * value;
    return (Jet){value, slope * a.first, slope * (a.second - 2.0 * (value * a.first * a.first))};
}

/* ---- Jets of jets ---- */

static inline Nested nested_constant(double value)
{
    return (Nested){jet_constant(value), jet_constant(0.0), jet_constant(0.0)};
}

static inline double nested_value(Nested a)
{
    return a.value.value;
}

static inline Nested nested_sum(Nested a, Nested b)
{
    return (Nested){jet_sum(a.value, b.value), jet_sum(a.first, b.first), jet_sum(a.second, b.second)};
}

static inline Nested nested_difference(Nested a, Nested b)
{
    return (Nested){jet_difference(a.value, b.value), jet_difference(a.first, b.first),
                    jet_difference(a.second, b.second)};
}

static inline Nested nested_product(Nested a, Nested b)
{
    const Jet first = jet_sum(jet_product(a.first, b.value), jet_product(a.value, b.first));
    const Jet mixed = jet_scaled(jet_product(a.first, b.first), 2.0);
    const Jet second = jet_sum(jet_sum(jet_product(a.second, b.value), mixed), jet_product(a.value, b.second));
    return (Nested){jet_product(a.value, b.value), first, second};
}

static inline Nested nested_scaled(Nested a, double by)
{
    return (Nested){jet_scaled(a.value, by), jet_scaled(a.first, by), jet_scaled(a.second, by)};
}

static inline void nested_sine_and_cosine(Nested a, Nested *sine, Nested *cosine)
{
    Jet s;
    Jet c;
    jet_sine_and_cosine(a.value, &s, &c);
    const Jet bent_sine = jet_product(jet_product(s, a.first), a.first);
    const Jet bent_cosine = jet_product(jet_product(c, a.first), a.first);
    const Jet down = jet_scaled(s, -1.0);
    *sine = (Nested){s, jet_product(c, a.first), jet_difference(jet_product(c, a.second), bent_sine)};
    *cosine = (Nested){c, jet_product(down, a.first), jet_difference(jet_product(down, a.second), bent_cosine)};
}

static inline Nested nested_hyperbolic_tangent(Nested a)
{
    const Jet value = jet_hyperbolic_tangent(a.value);
    const Jet slope = jet_difference(jet_constant(1.0), jet_product(value, value));
    const Jet bent = jet_product(jet_product(value, a.first), a.first);
    return (Nested){value, jet_product(slope, a.first),
                    jet_product(slope, jet_difference(a.second, jet_scaled(bent, 2.0)))};
}

#endif
