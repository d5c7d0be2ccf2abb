/*
 * Activation functions of a block of values. Loops of a constant length, free of branches and of calls: compilers turn
 * them into SIMD code at -O2 already, which they cannot do with the tanh of the C library.
 *
 * Not to be compiled with -ffast-math or its like: rounding is done by adding and subtracting a large number.
 */
#ifndef ACTIVATION_H
#define ACTIVATION_H

#include "model_data.h"
#include "real.h"
#include <stddef.h>

/* x becomes the activation of x. */
void activate(Activation activation, Real x[BLOCK]);

/* x becomes the activation of x; its first and second derivative go to slope and curvature. */
void activate_series(Activation activation, Real x[BLOCK], Real slope[BLOCK], Real curvature[BLOCK]);

/* The same of whole blocks, with slopes unless the pointer is null; jet_activation.h does it for jets. */
void real_activate(Activation activation, Real x[], Real *slopes, size_t count);

#endif
