/*
 * Outputs y and inputs u known by samples: the next sample of the outputs follows from past samples of both,
 *
 *     y[k + 1] = c + W z[k] + N(z[k]),    z[k] = (y[k], ..., y[k - n + 1], u[k], ..., u[k - m + 1], p)
 *
 * with parameters p and a network N. The inputs of a point are p, the starts of y, the starts of u, u; after them is
 * what is remembered: the past outputs, of one sample at least, and inputs, from the last to the first, the next
 * outputs, and the time since sample k in sample times. The model goes on at multiples of the sample time since the
 * start; an input counts at the sample; between samples the outputs are linear. A sample is at a communication point
 * that is nearer to it than a millionth of the sample time.
 */
#ifndef DISCRETE_H
#define DISCRETE_H

#include "functions.h"
#include "model.h"

/* Where a point has what is remembered. */
enum {
    MEMORY = INPUT_COUNT,
    MEMORY_INPUTS = MEMORY + PAST_OUTPUTS,
    MEMORY_NEXT = MEMORY_INPUTS + PAST_INPUTS,
    MEMORY_PHASE = MEMORY_NEXT + OUTPUT_COUNT,
    MEMORY_COUNT = MEMORY_PHASE + 1 - MEMORY
};

/* Columns of z. */
enum { REGRESSOR_COUNT = FED_BACK + PAST_INPUTS + PARAMETER_COUNT };

extern const double model_sample_time; /* s */
extern const Real model_weights[OUTPUT_COUNT * REGRESSOR_COUNT]; /* W, row by row */
extern const Real model_constants[OUTPUT_COUNT];                 /* c */
extern const NetworkTerm model_samples_network;                    /* N */

/* Working memory of one evaluation at a time. */
typedef struct {
    Real regressors[REGRESSOR_COUNT];
    Real added[OUTPUT_COUNT]; /* by the network */
    Real network[2 * NETWORK_WIDTH];
    double before[MEMORY_COUNT];
} Scratch;

#endif
