/*
 * A graph takes, in multiplications, additions and divisions,
 *
 *     2 n m    for an affine step of n numbers that makes m,
 *     4 n m    for distances of n numbers from m centres,
 *     1        for each number that two are combined to,
 *     5 n + 4  for a standardised vector of n numbers, besides a power,
 *     3 n      for a softmax, besides n exponentials and comparisons,
 *
 * an evaluation of its function for each number of an elementwise step, and for a forest an addition for a tree, besides
 * as many comparisons as it has levels of splits at worst.
 */
#include "evaluator.h"
#include <math.h>

/* A function's value with its first and second derivative. */
typedef struct {
    double value;
    double slope;
    double curvature;
} Series;

static const double SQRT_HALF = 0.70710678118654752440;
static const double TWO_BY_SQRT_PI = 1.12837916709551257390;
static const double SQRT_2_BY_PI = 0.79788456080286535588;

static Series hyperbolic_tangent(double x)
{
    /* where the cosine is infinite the slope is zero */
    const double cosine = cosh(x);
    const double y = tanh(x);
    const double slope = 1.0 / cosine / cosine;
    return (Series){y, slope, -2.0 * y * slope};
}

static Series sigmoid(double x)
{
    const Series half = hyperbolic_tangent(0.5 * x);
    return (Series){0.5 + 0.5 * half.value, 0.25 * half.slope, 0.125 * half.curvature};
}

static Series error_function(double x)
{
    const double slope = TWO_BY_SQRT_PI * exp(-x * x);
    return (Series){erf(x), slope, -2.0 * x * slope};
}

static Series gelu(double x)
{
    const double u1 = SQRT_2_BY_PI * (1.0 + 3.0 * 0.044715 * x * x);
    const double u2 = SQRT_2_BY_PI * 6.0 * 0.044715 * x;
    const Series t = hyperbolic_tangent(SQRT_2_BY_PI * (x + 0.044715 * x * x * x));
    const double outer = 0.5 * (1.0 + t.value);
    const double second = t.curvature * u1 * u1 + t.slope * u2;
    return (Series){x * outer, outer + 0.5 * x * t.slope * u1, t.slope * u1 + 0.5 * x * second};
}

static Series gelu_exact(double x)
{
    const Series e = error_function(x * SQRT_HALF);
    const double density = 0.5 * e.slope * SQRT_HALF;
    const double integral = 0.5 * (1.0 + e.value);
    return (Series){x * integral, integral + x * density, density * (2.0 - x * x)};
}

static double power_of(double x, double exponent)
{
    if (exponent == 0.5) {
        return sqrt(x);
    }
    return exponent == -0.5 ? 1.0 / sqrt(x) : pow(x, exponent);
}

static Series power(double x, double exponent)
{
    const double second = exponent * (exponent - 1.0);
    /* a factor of 0 stands before what may be infinite at 0 */
    return (Series){power_of(x, exponent), exponent == 0.0 ? 0.0 : exponent * power_of(x, exponent - 1.0),
                    second == 0.0 ? 0.0 : second * power_of(x, exponent - 2.0)};
}

static Series line(double x, double slope)
{
    return (Series){slope * x, slope, 0.0};
}

static Series series(Function function, double x, double p, double q)
{
    switch (function) {
    case FUNCTION_TANH:
        return hyperbolic_tangent(x);
    case FUNCTION_SIGMOID:
        return sigmoid(x);
    case FUNCTION_RELU:
        return line(x, x > 0.0 ? 1.0 : 0.0);
    case FUNCTION_GELU:
        return gelu(x);
    case FUNCTION_SILU: {
        const Series s = sigmoid(x);
        return (Series){x * s.value, s.value + x * s.slope, 2.0 * s.slope + x * s.curvature};
    }
    case FUNCTION_SINE:
        return (Series){sin(x), cos(x), -sin(x)};
    case FUNCTION_IDENTITY:
        return line(x, 1.0);
    case FUNCTION_LINEAR:
        return (Series){p * x + q, p, 0.0};
    case FUNCTION_COSINE:
        return (Series){cos(x), -sin(x), -cos(x)};
    case FUNCTION_EXPONENTIAL:
        return (Series){exp(x), exp(x), exp(x)};
    case FUNCTION_LOGARITHM:
        return (Series){log(x), 1.0 / x, -1.0 / (x * x)};
    case FUNCTION_RECIPROCAL: {
        const double y = 1.0 / x;
        return (Series){y, -y * y, 2.0 * y * y * y};
    }
    case FUNCTION_POWER:
        return power(x, p);
    case FUNCTION_ABSOLUTE:
        return (Series){fabs(x), x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : 0.0, 0.0};
    case FUNCTION_ERF:
        return error_function(x);
    case FUNCTION_GELU_EXACT:
        return gelu_exact(x);
    case FUNCTION_LEAKY_RELU:
        return line(x, x > 0.0 ? 1.0 : p);
    case FUNCTION_ELU: {
        const double slope = p * exp(x);
        return x > 0.0 ? line(x, 1.0) : (Series){p * expm1(x), slope, slope};
    }
    case FUNCTION_SOFTPLUS: {
        const Series s = sigmoid(x);
        return (Series){(x > 0.0 ? x : 0.0) + log1p(exp(-fabs(x))), s.value, s.slope};
    }
    case FUNCTION_SOFTSIGN: {
        const double y = 1.0 / (1.0 + fabs(x));
        return (Series){x * y, y * y, (x < 0.0 ? 2.0 : -2.0) * y * y * y};
    }
    case FUNCTION_CLIP:
        return x < p ? (Series){p, 0.0, 0.0} : x > q ? (Series){q, 0.0, 0.0} : line(x, 1.0);
    case FUNCTION_THRESHOLDED_RELU:
        return line(x, x > p ? 1.0 : 0.0);
    case FUNCTION_ARCTANGENT: {
        const double slope = 1.0 / (1.0 + x * x);
        return (Series){atan(x), slope, -2.0 * x * slope * slope};
    }
    case FUNCTION_SINGLE:
        return (Series){(double)(float)x, 1.0, 0.0};
    case FUNCTION_POSITIVE:
    default:
        return (Series){x > 0.0 ? 1.0 : 0.0, 0.0, 0.0};
    }
}

static double real_through(double a, Series f)
{
    (void)a;
    return f.value;
}

static Jet jet_through(Jet a, Series f)
{
    return (Jet){f.value, f.slope * a.first, f.slope * a.second + f.curvature * a.first * a.first};
}

#define NUMBER double
#define OF(name) real_##name
#include "graph_steps.h"
#undef NUMBER
#undef OF

#define NUMBER Jet
#define OF(name) jet_##name
#include "graph_steps.h"
#undef NUMBER
#undef OF

#if MODEL_HAS_MAPS

void map_evaluate(MapScratch *scratch, size_t map, const double columns[MAP_COLUMNS], double outputs[OUTPUT_COUNT])
{
    (void)map; /* there is one */
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        scratch->real[i] = columns[i];
    }
    real_graph(scratch->real);
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        outputs[i] = scratch->real[NUMBER_COUNT - OUTPUT_COUNT + i];
    }
}

/* The outputs along a curve; without second rates where the pointer is null. */
static const Jet *follow(Jet numbers[NUMBER_COUNT], const double columns[MAP_COLUMNS], const double rates[MAP_COLUMNS],
                         const double *second_rates)
{
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        numbers[i] = (Jet){columns[i], rates[i], second_rates == NULL ? 0.0 : second_rates[i]};
    }
    jet_graph(numbers);
    return &numbers[NUMBER_COUNT - OUTPUT_COUNT];
}

void map_along_curve(MapScratch *scratch, size_t map, const double columns[MAP_COLUMNS],
                     const double rates[MAP_COLUMNS], const double *second_rates, double first[OUTPUT_COUNT],
                     double *second)
{
    const Jet *outputs = follow(scratch->jet, columns, rates, second_rates);
    (void)map;
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        first[i] = outputs[i].first;
        if (second != NULL) {
            second[i] = outputs[i].second;
        }
    }
}

void map_adjoint(MapScratch *scratch, size_t map, const double columns[MAP_COLUMNS],
                 const double weights[OUTPUT_COUNT], double gradient[MAP_COLUMNS])
{
    double rates[MAP_COLUMNS] = {0.0};
    (void)map;
    for (size_t column = 0; column < MAP_COLUMNS; column++) {
        rates[column] = 1.0;
        const Jet *outputs = follow(scratch->jet, columns, rates, NULL);
        rates[column] = 0.0;
        gradient[column] = 0.0;
        for (size_t i = 0; i < OUTPUT_COUNT; i++) {
            gradient[column] += weights[i] * outputs[i].first;
        }
    }
}

#endif
