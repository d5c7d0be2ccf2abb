#include "activation.h"
#include "evaluator.h"
#include <math.h>

static const double TAU = 6.283185307179586476925286766559;

/* Columns of a layer that are added to a block of rows at a time: few enough for the registers of any processor. */
enum { GROUP = 4 };

static void fill(double *values, size_t count, double value)
{
    for (size_t i = 0; i < count; i++) {
        values[i] = value;
    }
}

/* Puts what the inputs become at a point into the scratch, and standardised into z. */
static void standardise(Scratch *scratch, const double point[COLUMN_COUNT], double z[WIDTH])
{
    double *feature = scratch->features;
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
    fill(z, WIDTH, 0.0);
    for (size_t i = 0; i < FEATURE_COUNT; i++) {
        z[i] = (scratch->features[i] - model_input_scaling[i].mean) / model_input_scaling[i].scale;
    }
}

/* First and second derivatives along a curve of what is in the scratch, standardised; second ones only if z2 is one. */
static void standardise_rates(const Scratch *scratch, const double rates[COLUMN_COUNT], double z1[WIDTH],
                              const double *second_rates, double *z2)
{
    size_t feature = 0;
    fill(z1, WIDTH, 0.0);
    if (z2 != NULL) {
        fill(z2, WIDTH, 0.0);
    }
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        const double bend = z2 == NULL ? 0.0 : second_rates[i];
        if (model_columns[i].value_count > 0) {
            feature += model_columns[i].value_count; /* constant nearly everywhere */
            continue;
        }
        if (model_turns[i].period > 0.0) {
            const double sine = scratch->features[feature];
            const double cosine = scratch->features[feature + 1];
            const double rate = TAU / model_turns[i].period * rates[i];
            const double change = TAU / model_turns[i].period * bend;
            z1[feature] = cosine * rate;
            z1[feature + 1] = -sine * rate;
            if (z2 != NULL) {
                z2[feature] = cosine * change - sine * rate * rate;
                z2[feature + 1] = -sine * change - cosine * rate * rate;
            }
            feature += 2;
            continue;
        }
        z1[feature] = rates[i];
        if (z2 != NULL) {
            z2[feature] = bend;
        }
        feature++;
    }
    for (size_t i = 0; i < FEATURE_COUNT; i++) {
        z1[i] /= model_input_scaling[i].scale;
        if (z2 != NULL) {
            z2[i] /= model_input_scaling[i].scale;
        }
    }
}

/* Derivatives by the inputs from those by what is in the scratch, standardised. */
static void by_inputs(const Scratch *scratch, const double *z, double gradient[COLUMN_COUNT])
{
    size_t feature = 0;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        if (model_columns[i].value_count > 0) {
            gradient[i] = 0.0;
            feature += model_columns[i].value_count;
            continue;
        }
        gradient[i] = z[feature] / model_input_scaling[feature].scale;
        if (model_turns[i].period > 0.0) {
            const double by_cosine = z[feature + 1] / model_input_scaling[feature + 1].scale;
            gradient[i] = TAU / model_turns[i].period *
                          (scratch->features[feature + 1] * gradient[i] - scratch->features[feature] * by_cosine);
            feature++;
        }
        feature++;
    }
}

static void rescale(double derivative[OUTPUT_COUNT])
{
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        derivative[i] *= model_output_scaling[i].scale;
    }
}

/* y += W x for one block of rows. */
static void add_block(const double *restrict weights, size_t columns, const double *restrict x, double *restrict y)
{
    size_t column = 0;
    for (; column + GROUP <= columns; column += GROUP) {
        const double *w = weights + column * BLOCK;
        const double a = x[column];
        const double b = x[column + 1];
        const double c = x[column + 2];
        const double d = x[column + 3];
        for (size_t row = 0; row < BLOCK; row++) {
            y[row] += (w[row] * a + w[BLOCK + row] * b) + (w[2 * BLOCK + row] * c + w[3 * BLOCK + row] * d);
        }
    }
    for (; column < columns; column++) {
        for (size_t row = 0; row < BLOCK; row++) {
            y[row] += weights[column * BLOCK + row] * x[column];
        }
    }
}

/* y = W x + b */
static void affine(const Layer *layer, const double *restrict x, double *restrict y)
{
    for (size_t block = 0; block < layer->blocks; block++) {
        for (size_t row = 0; row < BLOCK; row++) {
            y[block * BLOCK + row] = layer->bias[block * BLOCK + row];
        }
        add_block(layer->weights + block * layer->inputs * BLOCK, layer->inputs, x, y + block * BLOCK);
    }
}

/* y = W x */
static void linear(const Layer *layer, const double *restrict x, double *restrict y)
{
    fill(y, layer->blocks * BLOCK, 0.0);
    for (size_t block = 0; block < layer->blocks; block++) {
        add_block(layer->weights + block * layer->inputs * BLOCK, layer->inputs, x, y + block * BLOCK);
    }
}

/* The sum of a block, by halves: one number after the other would wait for each addition. */
static double sum_of(double sums[BLOCK])
{
    for (size_t half = BLOCK / 2; half > 0; half /= 2) {
        for (size_t i = 0; i < half; i++) {
            sums[i] += sums[half + i];
        }
    }
    return sums[0];
}

static double dot(const double *restrict a, const double *restrict b, size_t count)
{
    double sums[BLOCK] = {0.0};
    for (size_t start = 0; start < count; start += BLOCK) {
        for (size_t i = 0; i < BLOCK; i++) {
            sums[i] += a[start + i] * b[start + i];
        }
    }
    return sum_of(sums);
}

/* x = W^T y */
static void transposed(const Layer *layer, const double *restrict y, double *restrict x)
{
    fill(x, WIDTH, 0.0);
    for (size_t block = 0; block < layer->blocks; block++) {
        const double *weights = layer->weights + block * layer->inputs * BLOCK;
        for (size_t column = 0; column < layer->inputs; column++) {
            x[column] += dot(weights + column * BLOCK, y + block * BLOCK, BLOCK);
        }
    }
}

static void last_linear(const double x[WIDTH], double y[OUTPUT_COUNT])
{
    for (size_t row = 0; row < OUTPUT_COUNT; row++) {
        y[row] = dot(model_last_weights + row * LAST_COLUMNS, x, LAST_COLUMNS);
    }
}

static void last_transposed(const double y[OUTPUT_COUNT], double *restrict x)
{
    fill(x, WIDTH, 0.0);
    for (size_t row = 0; row < OUTPUT_COUNT; row++) {
        const double *weights = model_last_weights + row * LAST_COLUMNS;
        for (size_t column = 0; column < LAST_COLUMNS; column++) {
            x[column] += weights[column] * y[row];
        }
    }
}

void model_evaluate(Scratch *scratch, const double point[COLUMN_COUNT], double outputs[RESULT_COUNT])
{
    double *current = scratch->value[0];
    double *next = scratch->value[1];
    standardise(scratch, point, current);
    for (size_t i = 0; i < model_hidden_count; i++) {
        affine(&model_hidden[i], current, next);
        for (size_t block = 0; block < model_hidden[i].blocks; block++) {
            activate(model_hidden[i].activation, next + block * BLOCK);
        }
        double *const before = current;
        current = next;
        next = before;
    }
    last_linear(current, outputs);
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        outputs[i] = (outputs[i] + model_last_bias[i]) * model_output_scaling[i].scale + model_output_scaling[i].mean;
    }
}

void model_directional(Scratch *scratch, const double point[COLUMN_COUNT], const double direction[COLUMN_COUNT],
                       double derivative[RESULT_COUNT])
{
    size_t current = 0;
    standardise(scratch, point, scratch->value[0]);
    standardise_rates(scratch, direction, scratch->first[0], NULL, NULL);
    for (size_t i = 0; i < model_hidden_count; i++) {
        const Layer *layer = &model_hidden[i];
        const size_t next = 1 - current;
        double *value = scratch->value[next];
        double *first = scratch->first[next];
        affine(layer, scratch->value[current], value);
        linear(layer, scratch->first[current], first);
        for (size_t block = 0; block < layer->blocks * BLOCK; block += BLOCK) {
            double slope[BLOCK];
            double curvature[BLOCK];
            activate_series(layer->activation, value + block, slope, curvature);
            for (size_t row = 0; row < BLOCK; row++) {
                first[block + row] *= slope[row];
            }
        }
        current = next;
    }
    last_linear(scratch->first[current], derivative);
    rescale(derivative);
}

void model_along_curve(Scratch *scratch, const double point[COLUMN_COUNT], const double rates[COLUMN_COUNT],
                       const double second_rates[COLUMN_COUNT], double first_derivative[RESULT_COUNT],
                       double second_derivative[RESULT_COUNT])
{
    size_t current = 0;
    standardise(scratch, point, scratch->value[0]);
    standardise_rates(scratch, rates, scratch->first[0], second_rates, scratch->second[0]);
    for (size_t i = 0; i < model_hidden_count; i++) {
        const Layer *layer = &model_hidden[i];
        const size_t next = 1 - current;
        double *value = scratch->value[next];
        double *first = scratch->first[next];
        double *second = scratch->second[next];
        affine(layer, scratch->value[current], value);
        linear(layer, scratch->first[current], first);
        linear(layer, scratch->second[current], second);
        for (size_t block = 0; block < layer->blocks * BLOCK; block += BLOCK) {
            double slope[BLOCK];
            double curvature[BLOCK];
            activate_series(layer->activation, value + block, slope, curvature);
            for (size_t row = 0; row < BLOCK; row++) {
                const double rate = first[block + row];
                first[block + row] = slope[row] * rate;
                second[block + row] = slope[row] * second[block + row] + curvature[row] * rate * rate;
            }
        }
        current = next;
    }
    last_linear(scratch->first[current], first_derivative);
    last_linear(scratch->second[current], second_derivative);
    rescale(first_derivative);
    rescale(second_derivative);
}

/* Runs the hidden layers and notes the slopes of all activations. */
static void record_slopes(Scratch *scratch, const double point[COLUMN_COUNT])
{
    size_t current = 0;
    double *slope = scratch->slopes;
    standardise(scratch, point, scratch->value[0]);
    for (size_t i = 0; i < model_hidden_count; i++) {
        const Layer *layer = &model_hidden[i];
        double *value = scratch->value[1 - current];
        affine(layer, scratch->value[current], value);
        for (size_t block = 0; block < layer->blocks; block++) {
            double curvature[BLOCK];
            activate_series(layer->activation, value + block * BLOCK, slope, curvature);
            slope += BLOCK;
        }
        current = 1 - current;
    }
}

void model_adjoint(Scratch *scratch, const double point[COLUMN_COUNT], const double weights[RESULT_COUNT],
                     double gradient[COLUMN_COUNT])
{
    double scaled[OUTPUT_COUNT];
    double *current = scratch->first[0];
    double *next = scratch->first[1];
    size_t slopes = 0;
    record_slopes(scratch, point);
    for (size_t i = 0; i < model_hidden_count; i++) {
        slopes += model_hidden[i].blocks * BLOCK;
    }
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        scaled[i] = weights[i] * model_output_scaling[i].scale;
    }
    last_transposed(scaled, current);
    for (size_t i = model_hidden_count; i > 0; i--) {
        const Layer *layer = &model_hidden[i - 1];
        const size_t rows = layer->blocks * BLOCK;
        slopes -= rows;
        for (size_t row = 0; row < rows; row++) {
            current[row] *= scratch->slopes[slopes + row];
        }
        transposed(layer, current, next);
        double *const before = current;
        current = next;
        next = before;
    }
    by_inputs(scratch, current, gradient);
}
