/*
 * Functions in formulas of efforts, for real numbers and jets. A constant jet has zero derivatives, even where the
 * derivative of the function is infinite, such as that of the square root at zero.
 */
#ifndef FORMULAS_H
#define FORMULAS_H

#include <stddef.h>

#include "jets.h"

typedef enum { EXTRAPOLATION_HOLD, EXTRAPOLATION_LINEAR, EXTRAPOLATION_PERIODIC } Extrapolation;

/* A table of one argument, or of two if it has knots of the second. */
typedef struct {
    const Real *x;
    size_t x_count;
    const Real *y;
    size_t y_count;
    /* value at each node; with slopes, also the derivatives along x, along y, and the mixed one */
    const Real *nodes;
    int has_slopes;
    int is_cubic;
    Extrapolation extrapolation;
} LookupTable;

extern const LookupTable model_tables[];

/* A value of an argument at which the slope of a function changes much, and the distance to the nearer neighbor. */
typedef struct {
    Real at;
    Real width;
} Bend;

/* Argument of a table or a formula, and its bends. Arguments of one function have the same group. */
typedef struct {
    size_t of; /* a register of the equations */
    const Bend *bends;
    size_t count;
    Real start;  /* of the first period */
    Real period; /* 0 if the bends do not recur */
    size_t group;
} Argument;

extern const Argument model_arguments[];

typedef enum {
    FUNCTION_SIN,
    FUNCTION_COS,
    FUNCTION_TAN,
    FUNCTION_ASIN,
    FUNCTION_ACOS,
    FUNCTION_ATAN,
    FUNCTION_TANH,
    FUNCTION_EXP,
    FUNCTION_LN,
    FUNCTION_SQRT,
    FUNCTION_ABS,
    FUNCTION_SIGN,
    FUNCTION_FLOOR,
    FUNCTION_SMOOTH
} Function;

typedef enum { COMBINATION_DIVIDE, COMBINATION_POWER, COMBINATION_MINIMUM, COMBINATION_ANGLE } Combination;

static inline Real sign(Real x)
{
    if (x > R(0.0)) {
        return R(1.0);
    }
    return x < R(0.0) ? R(-1.0) : x;
}

static inline Real smooth(Real x)
{
    if (x < R(0.0)) {
        return R(0.0);
    }
    return x > R(1.0) ? R(1.0) : x * x * (R(3.0) - R(2.0) * x);
}

/* In the order of Function. */
static Real (*const FUNCTIONS[])(Real) = {MATH(sin), MATH(cos), MATH(tan),  MATH(asin), MATH(acos), MATH(atan),  MATH(tanh),
                                          MATH(exp), MATH(log), MATH(sqrt), MATH(fabs), sign,       MATH(floor), smooth};

/* Returns a function of a jet, given the function's value, slope and curvature. */
static inline Jet jet_chain(Jet a, Real value, Real slope, Real curvature)
{
    const Real square = a.first * a.first;
    const Real first = a.first < R(0.0) || a.first > R(0.0) ? slope * a.first : R(0.0);
    const Real bent = square > R(0.0) ? curvature * square : R(0.0);
    const Real second = a.second < R(0.0) || a.second > R(0.0) ? slope * a.second : R(0.0);
    return (Jet){value, first, bent + second};
}

static inline Real real_apply(Function function, Real a)
{
    return FUNCTIONS[function](a);
}

static inline Jet jet_apply(Function function, Jet a)
{
    const Real x = a.value;
    const Real y = FUNCTIONS[function](x);
    Real slope = R(0.0);
    Real curvature = R(0.0);
    switch (function) {
    case FUNCTION_SIN:
        slope = MATH(cos)(x);
        curvature = -y;
        break;
    case FUNCTION_COS:
        slope = -MATH(sin)(x);
        curvature = -y;
        break;
    case FUNCTION_TAN:
        slope = R(1.0) + y * y;
        curvature = R(2.0) * y * slope;
        break;
    case FUNCTION_ASIN:
    case FUNCTION_ACOS:
        slope = (function == FUNCTION_ASIN ? R(1.0) : R(-1.0)) / MATH(sqrt)(R(1.0) - x * x);
        curvature = x * (slope * slope * slope);
        break;
    case FUNCTION_ATAN:
        slope = R(1.0) / (R(1.0) + x * x);
        curvature = R(-2.0) * x * slope * slope;
        break;
    case FUNCTION_TANH:
        slope = R(1.0) - y * y;
        curvature = R(-2.0) * y * slope;
        break;
    case FUNCTION_EXP:
        slope = y;
        curvature = y;
        break;
    case FUNCTION_LN:
        slope = R(1.0) / x;
        curvature = R(-1.0) / (x * x);
        break;
    case FUNCTION_SQRT:
        slope = R(0.5) / y;
        curvature = R(-0.25) / (x * y);
        break;
    /* at a kink or a jump the derivatives are those of the piece that the curve enters */
    case FUNCTION_ABS:
        slope = jet_leading(a) < R(0.0) ? R(-1.0) : R(1.0);
        break;
    case FUNCTION_SIGN:
        return jet_constant(sign(jet_leading(a)));
    case FUNCTION_SMOOTH:
        if (x > R(0.0) && x < R(1.0)) {
            slope = R(6.0) * x * (R(1.0) - x);
            curvature = R(6.0) - R(12.0) * x;
        }
        break;
    case FUNCTION_FLOOR:
        break;
    }
    return jet_chain(a, y, slope, curvature);
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

/*
 * Returns the first of the two knots around x. Sets weights of value and slope at both knots, and the first three
 * derivatives of the weights: weights[order][knot][value or slope].
 */
static inline size_t lookup_weights(const LookupTable *table, const Real *knots, size_t count, Real x,
                                    Real weights[4][2][2])
{
    const Real start = knots[0];
    const Real end = knots[count - 1];
    if (table->extrapolation == EXTRAPOLATION_PERIODIC) {
        x -= MATH(floor)((x - start) / (end - start)) * (end - start);
    }
    size_t at = 0;
    size_t after = count - 1;
    while (after - at > 1) {
        const size_t middle = (at + after) / 2;
        if (knots[middle] <= x) {
            at = middle;
        } else {
            after = middle;
        }
    }
    for (size_t order = 0; order < 4; order++) {
        for (size_t knot = 0; knot < 2; knot++) {
            weights[order][knot][0] = R(0.0);
            weights[order][knot][1] = R(0.0);
        }
    }
    const int is_beyond = x < start || x > end;
    const size_t last = x < start ? 0 : 1;
    const Real h = knots[after] - knots[at];
    const Real w = (x - knots[at]) * (R(1.0) / h);
    const Real rest = R(1.0) - w;
    if (is_beyond && table->extrapolation != EXTRAPOLATION_PERIODIC) {
        weights[0][last][0] = R(1.0);
        /* extrapolate from the end: farther away, differences of values would lose their digits */
        if (table->extrapolation == EXTRAPOLATION_LINEAR) {
            weights[0][last][1] = x - (last > 0 ? end : start);
            weights[1][last][1] = R(1.0);
        }
    } else if (!table->is_cubic) {
        weights[0][0][0] = rest;
        weights[0][1][0] = w;
        weights[1][0][0] = R(-1.0) / h;
        weights[1][1][0] = R(1.0) / h;
    } else {
        for (size_t knot = 0; knot < 2; knot++) {
            const Real from = knot > 0 ? rest : w;
            const Real to = knot > 0 ? w : rest;
            const Real sign = knot > 0 ? R(-1.0) : R(1.0);
            weights[0][knot][0] = to * to * (R(1.0) + R(2.0) * from);
            weights[0][knot][1] = sign * h * (to * to * from);
            weights[1][knot][0] = sign * R(-6.0) * to * from / h;
            weights[1][knot][1] = to * (to - R(2.0) * from);
            weights[2][knot][0] = R(6.0) * (from - to) / (h * h);
            weights[2][knot][1] = sign * R(2.0) * (from - R(2.0) * to) / h;
            weights[3][knot][0] = sign * R(12.0) / (h * h * h);
            weights[3][knot][1] = R(6.0) / (h * h);
        }
    }
    return at;
}

/*
 * Computes the first `orders` numbers of this list: the value of a table, its derivatives along x, x x, y, x y, y y and
 * x x x. A table of one argument is constant along y.
 */
static inline void lookup_series(const LookupTable *table, Real x, Real y, Real series[], size_t orders)
{
    static const size_t of_orders[7][2] = {{0, 0}, {1, 0}, {2, 0}, {0, 1}, {1, 1}, {0, 2}, {3, 0}};
    Real of_x[4][2][2];
    Real of_y[4][2][2] = {{{R(0.0)}}};
    of_y[0][0][0] = R(1.0);
    const size_t rows = table->y_count > 0 ? table->y_count : 1;
    const size_t row = lookup_weights(table, table->x, table->x_count, x, of_x);
    const size_t column = table->y_count > 0 ? lookup_weights(table, table->y, table->y_count, y, of_y) : 0;
    const size_t of_axis = table->has_slopes ? 2 : 1;
    const size_t along_y = table->y_count > 0 ? 2 : 1;
    const size_t mixed = table->y_count > 0 ? of_axis : 1;
    for (size_t which = 0; which < orders; which++) {
        Real sum = R(0.0);
        for (size_t i = 0; i < 2; i++) {
            for (size_t j = 0; j < along_y; j++) {
                const Real *node = table->nodes + ((row + i) * rows + column + j) * of_axis * mixed;
                for (size_t number = 0; number < of_axis * mixed; number++) {
                    const Real weight =
                        of_x[of_orders[which][0]][i][number % 2] * of_y[of_orders[which][1]][j][number / 2];
                    sum += weight * node[number];
                }
            }
        }
        series[which] = sum;
    }
}

static inline Real real_lookup(const LookupTable *table, Real x, Real y)
{
    Real value;
    lookup_series(table, x, y, &value, 1);
    return value;
}

static inline Jet jet_lookup(const LookupTable *table, Jet x, Jet y)
{
    Real series[6];
    lookup_series(table, x.value, y.value, series, 6);
    const Real first = series[1] * x.first + series[3] * y.first;
    const Real bent = series[2] * x.first * x.first + R(2.0) * series[4] * x.first * y.first + series[5] * y.first * y.first;
    return (Jet){series[0], first, bent + series[1] * x.second + series[3] * y.second};
}

/* Evaluates a table of one argument. Its fourth derivative is zero. */
static inline Nested nested_lookup(const LookupTable *table, Nested x)
{
    Real series[7];
    lookup_series(table, x.value.value, R(0.0), series, 7);
    const Real first = x.value.first;
    const Real second = x.value.second;
    const Real slope = series[1];
    const Real curvature = series[2];
    const Real third = series[6];
    const Jet value = {series[0], slope * first, curvature * first * first + slope * second};
    const Jet slopes = {slope, curvature * first, third * first * first + curvature * second};
    const Jet curvatures = {curvature, third * first, third * second};
    const Jet bent = jet_product(jet_product(curvatures, x.first), x.first);
    return (Nested){value, jet_product(slopes, x.first), jet_sum(bent, jet_product(slopes, x.second))};
}

static inline Real real_power(Real a, Real b)
{
    return MATH(pow)(a, b);
}

/* Returns a factor times a power of x, or zero if the factor is zero. */
static inline Real real_term(Real factor, Real x, Real power)
{
    return factor < R(0.0) || factor > R(0.0) ? factor * MATH(pow)(x, power) : R(0.0);
}

static inline Jet jet_power(Jet a, Jet b)
{
    const Real value = MATH(pow)(a.value, b.value);
    const int changes = MATH(fabs)(b.first) > R(0.0) || MATH(fabs)(b.second) > R(0.0);
    /* at zero, a power vanishes for any exponent */
    if (changes && !(MATH(fabs)(a.value) <= R(0.0) && b.value > R(0.0))) {
        return jet_chain(jet_product(b, jet_apply(FUNCTION_LN, a)), value, value, value);
    }
    const Real p = b.value;
    const Real slope = real_term(p, a.value, p - R(1.0));
    return jet_chain(a, value, slope, real_term(p * (p - R(1.0)), a.value, p - R(2.0)));
}

#endif
