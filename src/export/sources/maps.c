/*
 * How long it takes at worst to compute the outputs, which a host asks for after a step, in multiplications, additions
 * and divisions: that of the columns,
 *
 *     3 (v - 1)    for an input with v values, besides 2 (v - 1) comparisons,
 *     4            for one with a period, besides rounding down, a sine and a cosine,
 *
 * and that of the map: network.c, regression.c and polynomial.h, forest.h or kernel.h, or graph.c have it. Of networks for k
 * instants two are evaluated, and
 *
 *     4 + 3 m      is what m outputs between them take, besides 4 + log2 k comparisons, rounded up.
 *
 * model_data.h has the numbers. The step itself takes none of them: outputs are computed when a host asks for them, once.
 */
#include "evaluator.h"
#include <math.h>

static const double TAU = 6.283185307179586476925286766559;

/* ---- Columns ---- */

static void encode(const double point[COLUMN_COUNT], double features[FEATURE_COUNT])
{
    double *feature = features;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        const Column *column = &model_columns[i];
        const Turn *turn = &model_turns[i];
        if (column->value_count > 0) {
            const size_t hot = nearest(column, point[i]);
            for (size_t k = 0; k < column->value_count; k++) {
                *feature++ = k == hot ? 1.0 : 0.0;
            }
        } else if (turn->period > 0.0) {
            /* whole turns are taken off first, so that a period later the columns are the very same */
            const double turns = (point[i] - turn->start) / turn->period;
            const double angle = TAU * (turns - floor(turns));
            *feature++ = sin(angle);
            *feature++ = cos(angle);
        } else {
            *feature++ = point[i];
        }
    }
}

/* First and second derivatives of the columns along a curve of the inputs; second ones only if there are such rates. */
static void encode_rates(const double features[FEATURE_COUNT], const double rates[COLUMN_COUNT],
                         const double *second_rates, double first[FEATURE_COUNT], double second[FEATURE_COUNT])
{
    size_t feature = 0;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        const double bend = second_rates == NULL ? 0.0 : second_rates[i];
        if (model_columns[i].value_count > 0) {
            /* constant nearly everywhere */
            for (size_t k = 0; k < model_columns[i].value_count; k++, feature++) {
                first[feature] = 0.0;
                second[feature] = 0.0;
            }
        } else if (model_turns[i].period > 0.0) {
            const double sine = features[feature];
            const double cosine = features[feature + 1];
            const double rate = TAU / model_turns[i].period * rates[i];
            const double change = TAU / model_turns[i].period * bend;
            first[feature] = cosine * rate;
            first[feature + 1] = -sine * rate;
            second[feature] = cosine * change - sine * rate * rate;
            second[feature + 1] = -sine * change - cosine * rate * rate;
            feature += 2;
        } else {
            first[feature] = rates[i];
            second[feature] = bend;
            feature++;
        }
    }
}

/* Derivatives by the inputs from those by the columns. */
static void by_inputs(const double features[FEATURE_COUNT], const double by_features[FEATURE_COUNT],
                      double gradient[COLUMN_COUNT])
{
    size_t feature = 0;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        if (model_columns[i].value_count > 0) {
            gradient[i] = 0.0;
            feature += model_columns[i].value_count;
        } else if (model_turns[i].period > 0.0) {
            gradient[i] = TAU / model_turns[i].period *
                          (features[feature + 1] * by_features[feature] - features[feature] * by_features[feature + 1]);
            feature += 2;
        } else {
            gradient[i] = by_features[feature];
            feature++;
        }
    }
}

#if MODEL_HAS_INSTANTS

/* ---- Instants ---- */

/* Between instant `left` and the next one: y = (1 - weight) y_left + weight y_right. */
typedef struct {
    size_t left;
    double weight;
    double slope; /* of the weight, per s */
} Place;

/* At an instant, the interval that begins there counts; at the last one, the one that ends there. */
static Place place_of(double time)
{
    /* the last interval that begins no later, if one does */
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
    const double size = model_instants[left + 1] - model_instants[left];
    const bool outside = time < model_instants[0] || time > model_instants[INSTANT_COUNT - 1];
    double weight = (time - model_instants[left]) / size;
    weight = weight < 0.0 ? 0.0 : weight > 1.0 ? 1.0 : weight;
    const Place place = {left, weight, outside ? 0.0 : 1.0 / size};
    return place;
}

static double between(const Place *place, double left, double right)
{
    return (1.0 - place->weight) * left + place->weight * right;
}

/* The columns other than the time. */
static void others(const double features[FEATURE_COUNT], double columns[MAP_COLUMNS])
{
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        columns[i] = features[i < TIME_FEATURE ? i : i + 1];
    }
}

static void evaluate(Scratch *scratch, const double features[FEATURE_COUNT], double outputs[OUTPUT_COUNT])
{
    double columns[MAP_COLUMNS];
    double right[OUTPUT_COUNT];
    const Place place = place_of(features[TIME_FEATURE]);
    others(features, columns);
    map_evaluate(&scratch->map, place.left, columns, outputs);
    map_evaluate(&scratch->map, place.left + 1, columns, right);
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        outputs[i] = between(&place, outputs[i], right[i]);
    }
}

static void along_curve(Scratch *scratch, const double features[FEATURE_COUNT], const double rates[FEATURE_COUNT],
                        const double *second_rates, double first[OUTPUT_COUNT], double *second)
{
    double columns[MAP_COLUMNS];
    double column_rates[2][MAP_COLUMNS];
    double values[2][OUTPUT_COUNT];
    double firsts[2][OUTPUT_COUNT];
    double seconds[2][OUTPUT_COUNT];
    const Place place = place_of(features[TIME_FEATURE]);
    /* of the weight along the curve */
    const double rate = place.slope * rates[TIME_FEATURE];
    const double acceleration = second == NULL ? 0.0 : place.slope * second_rates[TIME_FEATURE];
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
            second[i] = between(&place, seconds[0][i], seconds[1][i]) + 2.0 * rate * (firsts[1][i] - firsts[0][i]) +
                        acceleration * (values[1][i] - values[0][i]);
        }
    }
}

static void adjoint(Scratch *scratch, const double features[FEATURE_COUNT], const double weights[OUTPUT_COUNT],
                    double gradient[FEATURE_COUNT])
{
    double columns[MAP_COLUMNS];
    double values[2][OUTPUT_COUNT];
    double by_columns[2][MAP_COLUMNS];
    double by_time = 0.0;
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

static void evaluate(Scratch *scratch, const double features[FEATURE_COUNT], double outputs[OUTPUT_COUNT])
{
    map_evaluate(&scratch->map, 0, features, outputs);
}

static void along_curve(Scratch *scratch, const double features[FEATURE_COUNT], const double rates[FEATURE_COUNT],
                        const double *second_rates, double first[OUTPUT_COUNT], double *second)
{
    map_along_curve(&scratch->map, 0, features, rates, second_rates, first, second);
}

static void adjoint(Scratch *scratch, const double features[FEATURE_COUNT], const double weights[OUTPUT_COUNT],
                    double gradient[FEATURE_COUNT])
{
    map_adjoint(&scratch->map, 0, features, weights, gradient);
}

#endif

/* ---- The model ---- */

void model_evaluate(Scratch *scratch, const double point[COLUMN_COUNT], double results[RESULT_COUNT])
{
    double features[FEATURE_COUNT];
    encode(point, features);
    evaluate(scratch, features, results);
}

void model_directional(Scratch *scratch, const double point[COLUMN_COUNT], const double direction[COLUMN_COUNT],
                       double derivative[RESULT_COUNT])
{
    double features[FEATURE_COUNT];
    double first[FEATURE_COUNT];
    double second[FEATURE_COUNT];
    encode(point, features);
    encode_rates(features, direction, NULL, first, second);
    along_curve(scratch, features, first, NULL, derivative, NULL);
}

void model_along_curve(Scratch *scratch, const double point[COLUMN_COUNT], const double rates[COLUMN_COUNT],
                       const double second_rates[COLUMN_COUNT], double first_derivative[RESULT_COUNT],
                       double second_derivative[RESULT_COUNT])
{
    double features[FEATURE_COUNT];
    double first[FEATURE_COUNT];
    double second[FEATURE_COUNT];
    encode(point, features);
    encode_rates(features, rates, second_rates, first, second);
    along_curve(scratch, features, first, second, first_derivative, second_derivative);
}

void model_adjoint(Scratch *scratch, const double point[COLUMN_COUNT], const double weights[RESULT_COUNT],
                   double gradient[COLUMN_COUNT])
{
    double features[FEATURE_COUNT];
    double by_features[FEATURE_COUNT];
    encode(point, features);
    adjoint(scratch, features, weights, by_features);
    by_inputs(features, by_features, gradient);
}
