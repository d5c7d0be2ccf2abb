/*
 * The network: outputs, and their exact derivatives. Nothing here allocates, keeps anything between two calls but in
 * the scratch, or takes a time that depends on the numbers.
 */
#ifndef NETWORK_H
#define NETWORK_H

#include "model.h"

/* Working memory of one evaluation at a time; pairs of rows for a layer and the one after it. */
typedef struct {
    double value[2][WIDTH];
    double first[2][WIDTH];  /* first derivatives along the curve */
    double second[2][WIDTH]; /* second derivatives along the curve */
    double slopes[SLOPE_COUNT];
} Scratch;

/* Outputs at a point. */
void network_evaluate(Scratch *scratch, const double point[COLUMN_COUNT], double outputs[OUTPUT_COUNT]);

/* Derivative of the outputs in a direction: J direction. */
void network_directional(Scratch *scratch, const double point[COLUMN_COUNT], const double direction[COLUMN_COUNT],
                         double derivative[OUTPUT_COUNT]);

/* First and second time derivatives of the outputs, for columns that have the given first and second ones. */
void network_along_curve(Scratch *scratch, const double point[COLUMN_COUNT], const double rates[COLUMN_COUNT],
                         const double second_rates[COLUMN_COUNT], double first[OUTPUT_COUNT],
                         double second[OUTPUT_COUNT]);

/* Adjoint derivative: J^T weights. */
void network_adjoint(Scratch *scratch, const double point[COLUMN_COUNT], const double weights[OUTPUT_COUNT],
                     double gradient[COLUMN_COUNT]);

#endif
