/*
 * Outputs y and inputs u known by samples: the next sample of the outputs follows from past samples of both,
 *
 *     y[k + 1] = f(z[k]),    z[k] = (y[k], ..., y[k - n + 1], u[k], ..., u[k - m + 1], p)
 *
 * with parameters p and a graph f (graph.c). The last numbers of y may be hidden: they are
 * no outputs, and begin with numbers of the model. Inputs may act on outputs at the same instant: these are then y + D u. The inputs of a point are p, the starts of the outputs, the starts
 * of u if m > 1, u; after them is what is remembered: the past y, of one sample at least, and inputs, from the last to the
 * first; averages, last values and average changes of inputs and the distance from the support of the training (below), -1 before the
 * first sample, if it is known; measured outputs,
 * and 1 while they, less D u[k], replace those of y[k] before y[k + 1] is computed, else 0; the next y; the
 * time since sample k in sample times. The model advances at multiples of the sample time
 * since the start; an input counts at the sample; between samples y is linear. A sample is at a communication point
 * that is nearer to it than a millionth of the sample time.
 */
#ifndef DISCRETE_H
#define DISCRETE_H

#include "graph.h"
#include "model.h"

/* Where a point has what is remembered. */
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

/* Columns of z. */
enum { REGRESSOR_COUNT = FED_BACK + PAST_INPUTS + PARAMETER_COUNT };

extern const double model_sample_time; /* s */
extern const Real model_hidden[];              /* what is hidden, at the start */
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
 * without those of inputs if none is watched. The features from s on are coordinates: linear combinations of them are components, and the
 * sums and differences of any two of the first PAIRED_COUNT components are further measures. The distance of a transition is that of
 * its farthest measure from its range, relative to the width of the range. A distance lasts, and fades.
 */
extern const Real model_support_ranges[MEASURE_COUNT * 2];
extern const Real model_support_components[];
extern const Real model_support_samples; /* M */
extern const Real model_support_fading;  /* of a distance, from sample to sample */
extern const Real model_support_settling; /* the same while measured outputs are used: all past samples become measured */
#endif

/* Working memory of one evaluation at a time. */
typedef struct {
    Real graph[NUMBER_COUNT];
    double before[MEMORY_COUNT];
} Scratch;

#endif
