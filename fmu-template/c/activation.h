/*
 * Activation functions of a block of values. The loops have a constant length, no branches and no calls. Compilers turn
 * them into SIMD code even at -O2, which they cannot do with the tanh of the C library.
 *
 * Do not compile with -ffast-math or similar options: rounding adds and subtracts a large number.
 */
#ifndef ACTIVATION_H
#define ACTIVATION_H

#include "model_data.h"
#include "real.h"
#include <stddef.h>

/* Replaces x by its activation. */
void activate(Activation activation, Real x[BLOCK]);

/* Replaces x by its activation. Slope and curvature receive the first and second derivatives. */
void activate_series(Activation activation, Real x[BLOCK], Real slope[BLOCK], Real curvature[BLOCK]);

/* Replaces whole blocks by their activations. Slopes may be null. */
void real_activate(Activation activation, Real x[], Real *slopes, size_t count);

#endif
