/* A network, or one for each of several time points. The duration of a function does not depend on the numbers. */
#ifndef NETWORK_H
#define NETWORK_H

#include "activation.h"
#include "model.h"

/* The network takes (x - mean) / scale; its output is mean + scale * y. */
typedef struct {
    Real mean;
    Real scale;
} Scaling;

/*
 * A hidden layer: the activation of W x + b. The rows of W are padded with zeros to whole blocks of BLOCK rows. A
 * product reads them from first to last: weights[(block * inputs + column) * BLOCK + row].
 */
typedef struct {
    size_t inputs;
    size_t blocks;
    const Real *weights;
    const Real *bias;
    Activation activation;
} Layer;

/* A network. The weights of the last layer are row by row, with the columns padded with zeros to LAST_COLUMNS. */
typedef struct {
    const Scaling *input_scaling;
    const Scaling *output_scaling;
    size_t hidden_count;
    const Layer *hidden;
    const Real *last_weights;
    const Real *last_bias;
    Activation last_activation;
} Network;

extern const Network model_networks[];

/* Working memory of one evaluation at a time; pairs of rows for a layer and the next one. */
typedef struct {
    Real value[2][WIDTH];
    Real first[2][WIDTH];  /* first derivatives along the curve */
    Real second[2][WIDTH]; /* second derivatives along the curve */
    Real slopes[SLOPE_COUNT];
} MapScratch;

#endif
