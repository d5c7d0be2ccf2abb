/*
 * Worst-case cost of the outputs, in multiplications, additions and divisions:
 *
 *     2            for a column,
 *     2 i o        for a hidden layer of i columns and o nodes, rounded up to whole blocks of 16, besides activations:
 *                  at most 50 operations of activation.c for a node,
 *     2 i + 18     for an output, with the i nodes of the previous layer, rounded up to whole blocks of 16, besides its
 *                  activation if it has one.
 */
#include "evaluator.h"
#include "jets.h"

#define NUMBER Real
#define OF(name) real_##name
#include "blocks.h"

static INLINED void fill(Real *values, size_t count, Real value)
{
    for (size_t i = 0; i < count; i++) {
        values[i] = value;
    }
}

static INLINED void standardize(const Network *network, const Real columns[MAP_COLUMNS], Real z[WIDTH])
{
    fill(z, WIDTH, R(0.0));
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        z[i] = (columns[i] - network->input_scaling[i].mean) / network->input_scaling[i].scale;
    }
}

static INLINED void standardize_rates(const Network *network, const Real rates[MAP_COLUMNS], Real z[WIDTH])
{
    fill(z, WIDTH, R(0.0));
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        z[i] = rates[i] / network->input_scaling[i].scale;
    }
}

static INLINED void rescale(const Network *network, Real derivative[OUTPUT_COUNT])
{
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        derivative[i] *= network->output_scaling[i].scale;
    }
}

/* y = W x + b */
static INLINED void affine(const Layer *layer, const Real *restrict x, Real *restrict y)
{
    for (size_t block = 0; block < layer->blocks; block++) {
        for (size_t row = 0; row < BLOCK; row++) {
            y[block * BLOCK + row] = layer->bias[block * BLOCK + row];
        }
        real_add_block(layer->weights + block * layer->inputs * BLOCK, layer->inputs, x, y + block * BLOCK);
    }
}

/* y = W x */
static INLINED void linear(const Layer *layer, const Real *restrict x, Real *restrict y)
{
    fill(y, layer->blocks * BLOCK, R(0.0));
    for (size_t block = 0; block < layer->blocks; block++) {
        real_add_block(layer->weights + block * layer->inputs * BLOCK, layer->inputs, x, y + block * BLOCK);
    }
}

/* Sums a block by halves: adding one number after the other would wait for each addition. */
static INLINED Real sum_of(Real sums[BLOCK])
{
    for (size_t half = BLOCK / 2; half > 0; half /= 2) {
        for (size_t i = 0; i < half; i++) {
            sums[i] += sums[half + i];
        }
    }
    return sums[0];
}

static INLINED Real dot(const Real *restrict a, const Real *restrict b, size_t count)
{
    Real sums[BLOCK] = {R(0.0)};
    for (size_t start = 0; start < count; start += BLOCK) {
        for (size_t i = 0; i < BLOCK; i++) {
            sums[i] += a[start + i] * b[start + i];
        }
    }
    return sum_of(sums);
}

/* x = W^T y */
static INLINED void transposed(const Layer *layer, const Real *restrict y, Real *restrict x)
{
    fill(x, WIDTH, R(0.0));
    for (size_t block = 0; block < layer->blocks; block++) {
        const Real *weights = layer->weights + block * layer->inputs * BLOCK;
        for (size_t column = 0; column < layer->inputs; column++) {
            x[column] += dot(weights + column * BLOCK, y + block * BLOCK, BLOCK);
        }
    }
}

/* y = W x of the last layer */
static INLINED void last_linear(const Network *network, const Real x[WIDTH], Real y[OUTPUT_COUNT])
{
    for (size_t row = 0; row < OUTPUT_COUNT; row++) {
        y[row] = dot(network->last_weights + row * LAST_COLUMNS, x, LAST_COLUMNS);
    }
}

static INLINED void last_affine(const Network *network, const Real x[WIDTH], Real y[OUTPUT_COUNT])
{
    last_linear(network, x, y);
    for (size_t row = 0; row < OUTPUT_COUNT; row++) {
        y[row] += network->last_bias[row];
    }
}

static INLINED void last_transposed(const Network *network, const Real y[OUTPUT_COUNT], Real *restrict x)
{
    fill(x, WIDTH, R(0.0));
    for (size_t row = 0; row < OUTPUT_COUNT; row++) {
        const Real *weights = network->last_weights + row * LAST_COLUMNS;
        for (size_t column = 0; column < LAST_COLUMNS; column++) {
            x[column] += weights[column] * y[row];
        }
    }
}

/* Replaces y by its activation. Slope and curvature receive the first and second derivatives. */
static INLINED void activate_last(Activation activation, Real y[OUTPUT_COUNT], Real slope[OUTPUT_COUNT],
                          Real curvature[OUTPUT_COUNT])
{
    for (size_t start = 0; start < OUTPUT_COUNT; start += BLOCK) {
        Real values[BLOCK] = {R(0.0)};
        Real slopes[BLOCK];
        Real curvatures[BLOCK];
        const size_t count = start + BLOCK < OUTPUT_COUNT ? BLOCK : OUTPUT_COUNT - start;
        for (size_t i = 0; i < count; i++) {
            values[i] = y[start + i];
        }
        activate_series(activation, values, slopes, curvatures);
        for (size_t i = 0; i < count; i++) {
            y[start + i] = values[i];
            slope[start + i] = slopes[i];
            curvature[start + i] = curvatures[i];
        }
    }
}

CLONED void map_evaluate(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS], Real outputs[OUTPUT_COUNT])
{
    const Network *network = &model_networks[map];
    Real *current = scratch->value[0];
    Real *next = scratch->value[1];
    standardize(network, columns, current);
    for (size_t i = 0; i < network->hidden_count; i++) {
        const Layer *layer = &network->hidden[i];
        affine(layer, current, next);
        real_activate(layer->activation, next, NULL, layer->blocks * BLOCK);
        Real *const before = current;
        current = next;
        next = before;
    }
    last_affine(network, current, outputs);
    if (network->last_activation != ACTIVATION_IDENTITY) {
        Real slope[OUTPUT_COUNT];
        Real curvature[OUTPUT_COUNT];
        activate_last(network->last_activation, outputs, slope, curvature);
    }
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        outputs[i] = outputs[i] * network->output_scaling[i].scale + network->output_scaling[i].mean;
    }
}

CLONED void map_along_curve(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS],
                     const Real rates[MAP_COLUMNS], const Real *second_rates, Real first_derivative[OUTPUT_COUNT],
                     Real *second_derivative)
{
    const Network *network = &model_networks[map];
    const bool twice = second_derivative != NULL;
    size_t current = 0;
    standardize(network, columns, scratch->value[0]);
    standardize_rates(network, rates, scratch->first[0]);
    if (twice) {
        standardize_rates(network, second_rates, scratch->second[0]);
    }
    for (size_t i = 0; i < network->hidden_count; i++) {
        const Layer *layer = &network->hidden[i];
        const size_t next = 1 - current;
        Real *value = scratch->value[next];
        Real *first = scratch->first[next];
        Real *second = scratch->second[next];
        affine(layer, scratch->value[current], value);
        linear(layer, scratch->first[current], first);
        if (twice) {
            linear(layer, scratch->second[current], second);
        }
        for (size_t block = 0; block < layer->blocks * BLOCK; block += BLOCK) {
            Real slope[BLOCK];
            Real curvature[BLOCK];
            activate_series(layer->activation, value + block, slope, curvature);
            for (size_t row = 0; row < BLOCK; row++) {
                const Real rate = first[block + row];
                first[block + row] = slope[row] * rate;
                if (twice) {
                    second[block + row] = slope[row] * second[block + row] + curvature[row] * rate * rate;
                }
            }
        }
        current = next;
    }
    last_linear(network, scratch->first[current], first_derivative);
    if (twice) {
        last_linear(network, scratch->second[current], second_derivative);
    }
    if (network->last_activation != ACTIVATION_IDENTITY) {
        Real values[OUTPUT_COUNT];
        Real slope[OUTPUT_COUNT];
        Real curvature[OUTPUT_COUNT];
        last_affine(network, scratch->value[current], values);
        activate_last(network->last_activation, values, slope, curvature);
        for (size_t i = 0; i < OUTPUT_COUNT; i++) {
            const Real rate = first_derivative[i];
            first_derivative[i] = slope[i] * rate;
            if (twice) {
                second_derivative[i] = slope[i] * second_derivative[i] + curvature[i] * rate * rate;
            }
        }
    }
    rescale(network, first_derivative);
    if (twice) {
        rescale(network, second_derivative);
    }
}

CLONED void map_adjoint(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS],
                 const Real weights[OUTPUT_COUNT], Real gradient[MAP_COLUMNS])
{
    const Network *network = &model_networks[map];
    Real scaled[OUTPUT_COUNT];
    Real *slopes = scratch->slopes;
    size_t at = 0;
    standardize(network, columns, scratch->value[0]);
    /* slopes of all activations */
    for (size_t i = 0; i < network->hidden_count; i++) {
        const Layer *layer = &network->hidden[i];
        Real *value = scratch->value[1 - at];
        affine(layer, scratch->value[at], value);
        for (size_t block = 0; block < layer->blocks; block++) {
            Real curvature[BLOCK];
            activate_series(layer->activation, value + block * BLOCK, slopes, curvature);
            slopes += BLOCK;
        }
        at = 1 - at;
    }
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        scaled[i] = weights[i] * network->output_scaling[i].scale;
    }
    if (network->last_activation != ACTIVATION_IDENTITY) {
        Real values[OUTPUT_COUNT];
        Real slope[OUTPUT_COUNT];
        Real curvature[OUTPUT_COUNT];
        last_affine(network, scratch->value[at], values);
        activate_last(network->last_activation, values, slope, curvature);
        for (size_t i = 0; i < OUTPUT_COUNT; i++) {
            scaled[i] *= slope[i];
        }
    }
    Real *current = scratch->first[0];
    Real *next = scratch->first[1];
    last_transposed(network, scaled, current);
    for (size_t i = network->hidden_count; i > 0; i--) {
        const Layer *layer = &network->hidden[i - 1];
        const size_t rows = layer->blocks * BLOCK;
        slopes -= rows;
        for (size_t row = 0; row < rows; row++) {
            current[row] *= slopes[row];
        }
        transposed(layer, current, next);
        Real *const before = current;
        current = next;
        next = before;
    }
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        gradient[i] = current[i] / network->input_scaling[i].scale;
    }
}
