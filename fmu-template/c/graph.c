/*
 * Cost of a graph, in multiplications, additions and divisions:
 *
 *     2 n m    for an affine step from n numbers to m,
 *     4 n m    for distances of n numbers from m centers,
 *     1        for each pair of numbers that is combined,
 *     5 n + 4  for a normalized vector of n numbers, besides a power,
 *     3 n      for a softmax, besides n exponentials and comparisons,
 *     2        for each number of a line p x + q, and for each that is standardized or rescaled,
 *     3        for each number of a Gaussian function, besides an exponential,
 *     9 (d - 1) n + f    for products of Legendre polynomials of n numbers, with highest degree d > 0 and f factors in all.
 *
 * tape.h has the cost of sums of products of powers, sines and cosines. Other elementwise steps evaluate their function
 * for each number, rounded up to whole blocks of 16 for functions of activation.c. Each tree of a forest takes an
 * addition, and at worst one comparison for each level of splits.
 */
#include "activation.h"
#include "evaluator.h"
#include <string.h>

/* Value of a function with its first and second derivatives. */
typedef struct {
    Real value;
    Real slope;
    Real curvature;
} Series;

static const Real SQRT_HALF = R(0.70710678118654752440);
static const Real TWO_BY_SQRT_PI = R(1.12837916709551257390);

/* Uses exp(-|x|), so that small values keep their digits. */
static Series sigmoid(Real x)
{
    const Real e = MATH(exp)(-MATH(fabs)(x));
    const Real slope = e / (R(1.0) + e) / (R(1.0) + e);
    const Real tangent = -MATH(expm1)(-MATH(fabs)(x)) / (R(1.0) + e); /* tanh(|x| / 2) */
    return (Series){(x < R(0.0) ? e : R(1.0)) / (R(1.0) + e), slope, x < R(0.0) ? slope * tangent : -slope * tangent};
}

static Series error_function(Real x)
{
    const Real slope = TWO_BY_SQRT_PI * MATH(exp)(-x * x);
    return (Series){MATH(erf)(x), slope, -R(2.0) * x * slope};
}

static Series gelu_exact(Real x)
{
    const Series e = error_function(x * SQRT_HALF);
    const Real density = R(0.5) * e.slope * SQRT_HALF;
    const Real integral = R(0.5) * (R(1.0) + e.value);
    return (Series){x * integral, integral + x * density, density * (R(2.0) - x * x)};
}

static Real power_of(Real x, Real exponent)
{
    if (exponent == R(0.5)) {
        return MATH(sqrt)(x);
    }
    return exponent == -R(0.5) ? R(1.0) / MATH(sqrt)(x) : MATH(pow)(x, exponent);
}

static Series power(Real x, Real exponent)
{
    const Real second = exponent * (exponent - R(1.0));
    /* a factor of 0 precedes a power that may be infinite at 0 */
    return (Series){power_of(x, exponent), exponent == R(0.0) ? R(0.0) : exponent * power_of(x, exponent - R(1.0)),
                    second == R(0.0) ? R(0.0) : second * power_of(x, exponent - R(2.0))};
}

static Series line(Real x, Real slope)
{
    return (Series){slope * x, slope, R(0.0)};
}

/* Returns the series of a function that is not computed in blocks. */
static Series series(Function function, Real x, Real p, Real q)
{
    switch (function) {
    case FUNCTION_SIGMOID:
        return sigmoid(x);
    case FUNCTION_SILU: {
        const Series s = sigmoid(x);
        return (Series){x * s.value, s.value + x * s.slope, R(2.0) * s.slope + x * s.curvature};
    }
    case FUNCTION_LINEAR:
        return (Series){p * x + q, p, R(0.0)};
    case FUNCTION_COSINE:
        return (Series){MATH(cos)(x), -MATH(sin)(x), -MATH(cos)(x)};
    case FUNCTION_EXPONENTIAL:
        return (Series){MATH(exp)(x), MATH(exp)(x), MATH(exp)(x)};
    case FUNCTION_LOGARITHM:
        return (Series){MATH(log)(x), R(1.0) / x, -R(1.0) / (x * x)};
    case FUNCTION_RECIPROCAL: {
        const Real y = R(1.0) / x;
        return (Series){y, -y * y, R(2.0) * y * y * y};
    }
    case FUNCTION_POWER:
        return power(x, p);
    case FUNCTION_ABSOLUTE:
        return (Series){MATH(fabs)(x), x > R(0.0) ? R(1.0) : x < R(0.0) ? -R(1.0) : R(0.0), R(0.0)};
    case FUNCTION_ERF:
        return error_function(x);
    case FUNCTION_GELU_EXACT:
        return gelu_exact(x);
    case FUNCTION_LEAKY_RELU:
        return line(x, x > R(0.0) ? R(1.0) : p);
    case FUNCTION_ELU: {
        const Real slope = p * MATH(exp)(x);
        return x > R(0.0) ? line(x, R(1.0)) : (Series){p * MATH(expm1)(x), slope, slope};
    }
    case FUNCTION_SOFTPLUS: {
        const Series s = sigmoid(x);
        return (Series){(x > R(0.0) ? x : R(0.0)) + MATH(log1p)(MATH(exp)(-MATH(fabs)(x))), s.value, s.slope};
    }
    case FUNCTION_SOFTSIGN: {
        const Real y = R(1.0) / (R(1.0) + MATH(fabs)(x));
        return (Series){x * y, y * y, (x < R(0.0) ? R(2.0) : -R(2.0)) * y * y * y};
    }
    case FUNCTION_CLIP:
        return x < p ? (Series){p, R(0.0), R(0.0)} : x > q ? (Series){q, R(0.0), R(0.0)} : line(x, R(1.0));
    case FUNCTION_THRESHOLDED_RELU:
        return line(x, x > p ? R(1.0) : R(0.0));
    case FUNCTION_ARCTANGENT: {
        const Real slope = R(1.0) / (R(1.0) + x * x);
        return (Series){MATH(atan)(x), slope, -R(2.0) * x * slope * slope};
    }
    case FUNCTION_SINGLE:
        return (Series){(Real)(float)x, R(1.0), R(0.0)};
    case FUNCTION_GAUSSIAN: {
        const Real y = MATH(exp)(-R(0.5) * x);
        return (Series){y, -R(0.5) * y, R(0.25) * y};
    }
    case FUNCTION_POSITIVE:
    default:
        return (Series){x > R(0.0) ? R(1.0) : R(0.0), R(0.0), R(0.0)};
    }
}

static Real real_through(Real a, Series f)
{
    (void)a;
    return f.value;
}

static Jet jet_through(Jet a, Series f)
{
    return (Jet){f.value, f.slope * a.first, f.slope * a.second + f.curvature * a.first * a.first};
}

/* Returns the number of values in the block that begins at `first`. */
static INLINED size_t in_block(size_t count, size_t first)
{
    return count - first < BLOCK ? count - first : BLOCK;
}

/*
 * Returns true if activation.c computes a function: the first functions are the same, in the same order. Small
 * probabilities are zero in activation.c, but here a logarithm may follow, so a sigmoid must keep its digits.
 */
static bool is_in_blocks(Function function)
{
    return function <= FUNCTION_IDENTITY && function != FUNCTION_SIGMOID && function != FUNCTION_SILU;
}

static void real_activations(const GraphStep *step, const Real x[], Real y[])
{
    const size_t rest = step->count % BLOCK;
    const size_t whole = step->count - rest;
    memcpy(y, x, whole * sizeof *y);
    real_activate((Activation)step->function, y, NULL, whole);
    if (rest > 0) {
        Real values[BLOCK] = {R(0.0)};
        memcpy(values, x + whole, rest * sizeof *y);
        activate((Activation)step->function, values);
        memcpy(y + whole, values, rest * sizeof *y);
    }
}

static void jet_activations(const GraphStep *step, const Jet x[], Jet y[])
{
    for (size_t first = 0; first < step->count; first += BLOCK) {
        const size_t count = in_block(step->count, first);
        Real values[BLOCK] = {R(0.0)};
        Real slopes[BLOCK];
        Real curvatures[BLOCK];
        for (size_t i = 0; i < count; i++) {
            values[i] = x[first + i].value;
        }
        activate_series((Activation)step->function, values, slopes, curvatures);
        for (size_t i = 0; i < count; i++) {
            y[first + i] = jet_through(x[first + i], (Series){values[i], slopes[i], curvatures[i]});
        }
    }
}

#define CALL(operation, registers) break /* there are no formulas */

#define NUMBER Real
#define OF(name) real_##name
#if MODEL_HAS_DICTIONARY
#include "tape_run.h"
#else
#include "blocks.h"
#endif
#include "graph_steps.h"
#undef NUMBER
#undef OF

#define NUMBER Jet
#define OF(name) jet_##name
#if MODEL_HAS_DICTIONARY
#include "activation_formulas.h"
#include "tape_run.h"
#else
#include "blocks.h"
#endif
#include "graph_steps.h"
#undef NUMBER
#undef OF

#if MODEL_HAS_MAPS

void map_evaluate(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS], Real outputs[OUTPUT_COUNT])
{
    (void)map; /* there is only one */
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        scratch->real[i] = columns[i];
    }
    real_graph(scratch->real);
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        outputs[i] = scratch->real[NUMBER_COUNT - OUTPUT_COUNT + i];
    }
}

/* Computes the outputs along a curve. A null pointer means no second rates. */
static const Jet *follow(Jet numbers[NUMBER_COUNT], const Real columns[MAP_COLUMNS], const Real rates[MAP_COLUMNS],
                         const Real *second_rates)
{
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        numbers[i] = (Jet){columns[i], rates[i], second_rates == NULL ? R(0.0) : second_rates[i]};
    }
    jet_graph(numbers);
    return &numbers[NUMBER_COUNT - OUTPUT_COUNT];
}

void map_along_curve(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS],
                     const Real rates[MAP_COLUMNS], const Real *second_rates, Real first[OUTPUT_COUNT],
                     Real *second)
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

void map_adjoint(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS],
                 const Real weights[OUTPUT_COUNT], Real gradient[MAP_COLUMNS])
{
    Real rates[MAP_COLUMNS] = {R(0.0)};
    (void)map;
    for (size_t column = 0; column < MAP_COLUMNS; column++) {
        rates[column] = R(1.0);
        const Jet *outputs = follow(scratch->jet, columns, rates, NULL);
        rates[column] = R(0.0);
        gradient[column] = R(0.0);
        for (size_t i = 0; i < OUTPUT_COUNT; i++) {
            gradient[column] += weights[i] * outputs[i].first;
        }
    }
}

#endif
