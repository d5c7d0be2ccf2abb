/*
 * Worst-case cost of the outputs, which a host reads after a step, in multiplications, additions and divisions. Columns
 * take
 *
 *     3 (v - 1)    for an input with v values, besides 2 (v - 1) comparisons,
 *     4            for one with a period, besides rounding down, a sine and a cosine.
 *
 * network.c or graph.c has the cost of the map. If there are networks for k time points, two of them are evaluated, and
 * interpolation takes
 *
 *     4 + 3 m      for m outputs, besides 4 + log2 k comparisons, rounded up.
 *
 * model_data.h has the numbers. The step takes none of these operations: outputs are computed once, when a host reads
 * them.
 */
#include "evaluator.h"

static const double TAU = 6.283185307179586476925286766559;

/* ---- Columns ---- */

/* Computes columns from a point. Valid values and turns are found in double precision, so that no digits get lost far from zero. */
static void encode(const double point[COLUMN_COUNT], Real features[FEATURE_COUNT])
{
    Real *feature = features;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        const Column *column = &model_columns[i];
        const Turn *turn = &model_turns[i];
        if (column->value_count > 0) {
            const size_t hot = nearest(column, point[i]);
            for (size_t k = 0; k < column->value_count; k++) {
                *feature++ = k == hot ? R(1.0) : R(0.0);
            }
        } else if (turn->period > 0.0) {
            /* remove whole turns first, so that columns are identical one period later */
            const double turns = (point[i] - turn->start) / turn->period;
            const Real angle = (Real)(TAU * (turns - floor(turns)));
            *feature++ = MATH(sin)(angle);
            *feature++ = MATH(cos)(angle);
        } else {
            *feature++ = (Real)point[i];
        }
    }
}

/* Computes first and second derivatives of the columns along a curve of the inputs; second ones only with second rates. */
static void encode_rates(const Real features[FEATURE_COUNT], const double rates[COLUMN_COUNT],
                         const double *second_rates, Real first[FEATURE_COUNT], Real second[FEATURE_COUNT])
{
    size_t feature = 0;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        const Real along = (Real)rates[i];
        const Real bend = second_rates == NULL ? R(0.0) : (Real)second_rates[i];
        if (model_columns[i].value_count > 0) {
            /* constant almost everywhere */
            for (size_t k = 0; k < model_columns[i].value_count; k++, feature++) {
                first[feature] = R(0.0);
                second[feature] = R(0.0);
            }
        } else if (model_turns[i].period > 0.0) {
            const Real sine = features[feature];
            const Real cosine = features[feature + 1];
            const Real rate = (Real)(TAU / model_turns[i].period) * along;
            const Real change = (Real)(TAU / model_turns[i].period) * bend;
            first[feature] = cosine * rate;
            first[feature + 1] = -sine * rate;
            second[feature] = cosine * change - sine * rate * rate;
            second[feature + 1] = -sine * change - cosine * rate * rate;
            feature += 2;
        } else {
            first[feature] = along;
            second[feature] = bend;
            feature++;
        }
    }
}

/* Converts derivatives with respect to columns to derivatives with respect to inputs. */
static void by_inputs(const Real features[FEATURE_COUNT], const Real by_features[FEATURE_COUNT],
                      double gradient[COLUMN_COUNT])
{
    size_t feature = 0;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        if (model_columns[i].value_count > 0) {
            gradient[i] = 0.0;
            feature += model_columns[i].value_count;
        } else if (model_turns[i].period > 0.0) {
            const Real turned =
                features[feature + 1] * by_features[feature] - features[feature] * by_features[feature + 1];
            gradient[i] = TAU / model_turns[i].period * (double)turned;
            feature += 2;
        } else {
            gradient[i] = (double)by_features[feature];
            feature++;
        }
    }
}

#if MODEL_HAS_INSTANTS

/* ---- Time points ---- */

/* Interpolation between time point `left` and the next one: y = (1 - weight) y_left + weight y_right. */
typedef struct {
    size_t left;
    Real weight;
    Real slope; /* derivative of the weight, per s */
} Place;

/* Finds the interval of a time. A time point belongs to the interval that begins there, the last one to the interval that ends there. */
static Place place_of(Real time)
{
    /* the last interval that begins no later, otherwise the first one */
    size_t left = 0;
    size_t end = INSTANT_COUNT - 1;
    while (end - left > 1) {
        const size_t middle = left + (end - left) / 2;
        if (model_instants[middle] <= time) {
            left = middle;
        } else {
            end = middle;
        }
    }
    const Real size = model_instants[left + 1] - model_instants[left];
    const bool outside = time < model_instants[0] || time > model_instants[INSTANT_COUNT - 1];
    Real weight = (time - model_instants[left]) / size;
    weight = weight < R(0.0) ? R(0.0) : weight > R(1.0) ? R(1.0) : weight;
    const Place place = {left, weight, outside ? R(0.0) : R(1.0) / size};
    return place;
}

static Real between(const Place *place, Real left, Real right)
{
    return (R(1.0) - place->weight) * left + place->weight * right;
}

/* Copies the columns other than the time. */
static void others(const Real features[FEATURE_COUNT], Real columns[MAP_COLUMNS])
{
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        columns[i] = features[i < TIME_FEATURE ? i : i + 1];
    }
}

static void evaluate(Scratch *scratch, const Real features[FEATURE_COUNT], Real outputs[OUTPUT_COUNT])
{
    Real columns[MAP_COLUMNS];
    Real right[OUTPUT_COUNT];
    const Place place = place_of(features[TIME_FEATURE]);
    others(features, columns);
    map_evaluate(&scratch->map, place.left, columns, outputs);
    map_evaluate(&scratch->map, place.left + 1, columns, right);
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        outputs[i] = between(&place, outputs[i], right[i]);
    }
}

static void along_curve(Scratch *scratch, const Real features[FEATURE_COUNT], const Real rates[FEATURE_COUNT],
                        const Real *second_rates, Real first[OUTPUT_COUNT], Real *second)
{
    Real columns[MAP_COLUMNS];
    Real column_rates[2][MAP_COLUMNS];
    Real values[2][OUTPUT_COUNT];
    Real firsts[2][OUTPUT_COUNT];
    Real seconds[2][OUTPUT_COUNT];
    const Place place = place_of(features[TIME_FEATURE]);
    /* derivatives of the weight along the curve */
    const Real rate = place.slope * rates[TIME_FEATURE];
    const Real acceleration = second == NULL ? R(0.0) : place.slope * second_rates[TIME_FEATURE];
    others(features, columns);
    others(rates, column_rates[0]);
    if (second != NULL) {
        others(second_rates, column_rates[1]);
    }
    for (size_t side = 0; side < 2; side++) {
        map_evaluate(&scratch->map, place.left + side, columns, values[side]);
        map_along_curve(&scratch->map, place.left + side, columns, column_rates[0],
                        second == NULL ? NULL : column_rates[1], firsts[side], second == NULL ? NULL : seconds[side]);
    }
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        first[i] = between(&place, firsts[0][i], firsts[1][i]) + rate * (values[1][i] - values[0][i]);
        if (second != NULL) {
            second[i] = between(&place, seconds[0][i], seconds[1][i]) + R(2.0) * rate * (firsts[1][i] - firsts[0][i]) +
                        acceleration * (values[1][i] - values[0][i]);
        }
    }
}

static void adjoint(Scratch *scratch, const Real features[FEATURE_COUNT], const Real weights[OUTPUT_COUNT],
                    Real gradient[FEATURE_COUNT])
{
    Real columns[MAP_COLUMNS];
    Real values[2][OUTPUT_COUNT];
    Real by_columns[2][MAP_COLUMNS];
    Real by_time = R(0.0);
    const Place place = place_of(features[TIME_FEATURE]);
    others(features, columns);
    for (size_t side = 0; side < 2; side++) {
        map_evaluate(&scratch->map, place.left + side, columns, values[side]);
        map_adjoint(&scratch->map, place.left + side, columns, weights, by_columns[side]);
    }
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        by_time += place.slope * weights[i] * (values[1][i] - values[0][i]);
    }
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        gradient[i < TIME_FEATURE ? i : i + 1] = between(&place, by_columns[0][i], by_columns[1][i]);
    }
    gradient[TIME_FEATURE] = by_time;
}

#else

/* ---- One map ---- */

static void evaluate(Scratch *scratch, const Real features[FEATURE_COUNT], Real outputs[OUTPUT_COUNT])
{
    map_evaluate(&scratch->map, 0, features, outputs);
}

static void along_curve(Scratch *scratch, const Real features[FEATURE_COUNT], const Real rates[FEATURE_COUNT],
                        const Real *second_rates, Real first[OUTPUT_COUNT], Real *second)
{
    map_along_curve(&scratch->map, 0, features, rates, second_rates, first, second);
}

static void adjoint(Scratch *scratch, const Real features[FEATURE_COUNT], const Real weights[OUTPUT_COUNT],
                    Real gradient[FEATURE_COUNT])
{
    map_adjoint(&scratch->map, 0, features, weights, gradient);
}

#endif

/* ---- The model ---- */

static void widen(const Real outputs[OUTPUT_COUNT], double results[RESULT_COUNT])
{
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        results[i] = (double)outputs[i];
    }
}

void model_evaluate(Scratch *scratch, const double point[COLUMN_COUNT], double results[RESULT_COUNT])
{
    Real features[FEATURE_COUNT];
    Real outputs[OUTPUT_COUNT];
    encode(point, features);
    evaluate(scratch, features, outputs);
    widen(outputs, results);
}

void model_directional(Scratch *scratch, const double point[COLUMN_COUNT], const double direction[COLUMN_COUNT],
                       double derivative[RESULT_COUNT])
{
    Real features[FEATURE_COUNT];
    Real first[FEATURE_COUNT];
    Real second[FEATURE_COUNT];
    Real outputs[OUTPUT_COUNT];
    encode(point, features);
    encode_rates(features, direction, NULL, first, second);
    along_curve(scratch, features, first, NULL, outputs, NULL);
    widen(outputs, derivative);
}

void model_along_curve(Scratch *scratch, const double point[COLUMN_COUNT], const double rates[COLUMN_COUNT],
                       const double second_rates[COLUMN_COUNT], double first_derivative[RESULT_COUNT],
                       double second_derivative[RESULT_COUNT])
{
    Real features[FEATURE_COUNT];
    Real first[FEATURE_COUNT];
    Real second[FEATURE_COUNT];
    Real outputs[2][OUTPUT_COUNT];
    encode(point, features);
    encode_rates(features, rates, second_rates, first, second);
    along_curve(scratch, features, first, second, outputs[0], outputs[1]);
    widen(outputs[0], first_derivative);
    widen(outputs[1], second_derivative);
}

void model_adjoint(Scratch *scratch, const double point[COLUMN_COUNT], const double weights[RESULT_COUNT],
                   double gradient[COLUMN_COUNT])
{
    Real features[FEATURE_COUNT];
    Real by_features[FEATURE_COUNT];
    Real of_outputs[OUTPUT_COUNT];
    encode(point, features);
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        of_outputs[i] = (Real)weights[i];
    }
    adjoint(scratch, features, of_outputs, by_features);
    by_inputs(features, by_features, gradient);
}
