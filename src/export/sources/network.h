/*
 * A network. No function takes a time that depends on the numbers.
 */
#ifndef NETWORK_H
#define NETWORK_H

#include "activation.h"
#include "model.h"

/* (x - mean) / scale goes into the network; mean + scale * y is what comes out. */
typedef struct {
    double mean;
    double scale;
} Scaling;

/*
 * How an input becomes columns of the network: as it is; one of a column's values as a column for each, 1 for the
 * nearest and 0 for the others; or, if the period is not zero, as sine and cosine of 2 pi (x - start) / period.
 */
typedef struct {
    double start;
    double period;
} Turn;

/*
 * A hidden layer, the activation of W x + b. The rows of W are padded with zeros to whole blocks of BLOCK rows;
 * weights[(block * inputs + column) * BLOCK + row], so that a product reads them from first to last.
 */
typedef struct {
    size_t inputs;
    size_t blocks;
    const double *weights;
    const double *bias;
    Activation activation;
} Layer;

extern const Turn model_turns[COLUMN_COUNT];
extern const Scaling model_input_scaling[FEATURE_COUNT];
extern const Scaling model_output_scaling[OUTPUT_COUNT];
extern const size_t model_hidden_count;
extern const Layer model_hidden[];
/* The last layer, row by row, with the columns padded with zeros to LAST_COLUMNS. */
extern const double model_last_weights[OUTPUT_COUNT * LAST_COLUMNS];
extern const double model_last_bias[OUTPUT_COUNT];

/* Working memory of one evaluation at a time; pairs of rows for a layer and the one after it. */
typedef struct {
    double features[FEATURE_COUNT]; /* columns of the network */
    double value[2][WIDTH];
    double first[2][WIDTH];  /* first derivatives along the curve */
    double second[2][WIDTH]; /* second derivatives along the curve */
    double slopes[SLOPE_COUNT];
} Scratch;

#endif
