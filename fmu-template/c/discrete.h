/*
 * Discrete-time model: the next sample of the outputs y follows from past samples of y and of the inputs u,
 *
 *     y[k + 1] = f(z[k]),    z[k] = (y[k], ..., y[k - n + 1], u[k], ..., u[k - m + 1], p)
 *
 * with parameters p and a graph f (graph.c). The last numbers of y may be hidden: they are not outputs, and their start
 * values belong to the model. If inputs act directly on outputs, the outputs are y + D u.
 *
 * The inputs of a point are p, the starts of the outputs, the starts of u if m > 1, and u. They are followed by the
 * memory:
 *
 *     - past samples of y, at least one, and of inputs, from the last to the first;
 *     - averages, last values and average changes of inputs, if the training support is known;
 *     - distance from the training support (below), if it is known; -1 before the first sample;
 *     - measured outputs;
 *     - 1 while measured outputs, less D u[k], replace y[k] before y[k + 1] is computed, else 0;
 *     - the next y;
 *     - time since sample k, in sample times.
 *
 * The model advances at multiples of the sample time since the start. Inputs take effect at samples; between samples, y
 * is linear. A sample coincides with a communication point that is nearer to it than a millionth of the sample time.
 */
#ifndef DISCRETE_H
#define DISCRETE_H

#include "graph.h"
#include "model.h"

/* Positions of the memory in a point. */
enum {
    MEMORY = INPUT_COUNT,
    MEMORY_INPUTS = MEMORY + PAST_OUTPUTS,
    MEMORY_MEANS = MEMORY_INPUTS + PAST_INPUTS,
    MEMORY_LAST = MEMORY_MEANS + WATCHED_COUNT,
    MEMORY_CHANGES = MEMORY_LAST + WATCHED_COUNT,
    MEMORY_ERROR = MEMORY_CHANGES + WATCHED_COUNT,
    MEMORY_DISTANCE = MEMORY_ERROR + MODEL_HAS_SUPPORT,
    MEMORY_MEASURED = MEMORY_DISTANCE + MODEL_HAS_SUPPORT, /* FIRST_MEASURED */
    MEMORY_USE_MEASURED = MEMORY_MEASURED + OUTPUT_COUNT,
    MEMORY_NEXT = MEMORY_USE_MEASURED + 1,
    MEMORY_PHASE = MEMORY_NEXT + SAMPLE_SIZE,
    MEMORY_COUNT = MEMORY_PHASE + 1 - MEMORY
};

/* Number of columns of z. */
enum { REGRESSOR_COUNT = FED_BACK + PAST_INPUTS + PARAMETER_COUNT };

extern const double model_sample_time; /* s */
extern const Real model_hidden[];              /* start values of hidden numbers */
#if MODEL_HAS_DIRECT
extern const Real model_direct[OUTPUT_COUNT * DRIVEN_COUNT]; /* D, output by output */
#endif
#if MODEL_HAS_SUPPORT
/*
 * Training ranges of measures of the transition from sample k to sample k + 1. The first measures are features of it,
 *
 *     u[k],  u[k] - u[k - 1],  r[k] = r[k - 1] + (|u[k] - u[k - 1]| - r[k - 1]) / M,
 *     s[k] = s[k - 1] + (u[k] - s[k - 1]) / M,  y[k + 1],  y[k + 1] - y[k],  hidden states after it
 *
 * without those of inputs if none is watched. The features from s on are coordinates, and components are linear
 * combinations of them. Further measures are the sums and differences of any two of the first PAIRED_COUNT components.
 *
 * The distance of a transition is the largest distance of a measure from its range, relative to the width of the range.
 * A distance persists, and fades.
 */
extern const Real model_support_ranges[MEASURE_COUNT * 2];
extern const Real model_support_components[];
extern const Real model_support_samples; /* M */
extern const Real model_support_fading;  /* of a distance, from sample to sample */
extern const Real model_support_settling; /* fading while measured outputs are used: all past samples become measured */
#endif

/* Working memory of one evaluation at a time. */
typedef struct {
    Real graph[NUMBER_COUNT];
    double before[MEMORY_COUNT];
} Scratch;

#endif
