/*
 * A formula of standardised columns: sums of products of polynomials, of decision trees, or of kernels.
 */
#ifndef REGRESSION_H
#define REGRESSION_H

#include "jets.h"
#include "model.h"

/* (x - mean) / scale goes into the function; mean + scale * y is what comes out. */
typedef struct {
    Real mean;
    Real scale;
} Scaling;

extern const Scaling model_input_scaling[MAP_COLUMNS];
extern const Scaling model_output_scaling[OUTPUT_COUNT];

#include FUNCTION_HEADER

/* Working memory of an evaluation in one kind of numbers. */
#define REGRESSION_WORK(Name, Number) \
    typedef struct {                  \
        Number columns[MAP_COLUMNS];  \
        Number outputs[OUTPUT_COUNT]; \
        Number table[TABLE_SIZE];     \
    } Name

REGRESSION_WORK(RealWork, Real);
REGRESSION_WORK(JetWork, Jet);

/* Working memory of one evaluation at a time. */
typedef struct {
    RealWork real;
    JetWork jet;
} MapScratch;

#endif
