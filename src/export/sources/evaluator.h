/*
 * What computes the surrogate: a network (network.c) or equations of motion (motion.c). A point has one value for each
 * input and, after them, one for each state; results are the outputs and, after them, the states' derivatives with
 * respect to time. Nothing here allocates or keeps anything between two calls but in the scratch.
 */
#ifndef EVALUATOR_H
#define EVALUATOR_H

#include "model.h"

#if MODEL_HAS_STATES
#include "motion.h"
#else
#include "network.h"
#endif

/* Results at a point. */
void model_evaluate(Scratch *scratch, const double point[COLUMN_COUNT], double results[RESULT_COUNT]);

/* Derivative of the results in a direction: J direction. */
void model_directional(Scratch *scratch, const double point[COLUMN_COUNT], const double direction[COLUMN_COUNT],
                       double derivative[RESULT_COUNT]);

/* First and second derivatives of the results along a curve on which the columns have the given ones. */
void model_along_curve(Scratch *scratch, const double point[COLUMN_COUNT], const double rates[COLUMN_COUNT],
                       const double second_rates[COLUMN_COUNT], double first[RESULT_COUNT],
                       double second[RESULT_COUNT]);

/* Adjoint derivative: J^T weights. With states it takes as long as a directional derivative for each column. */
void model_adjoint(Scratch *scratch, const double point[COLUMN_COUNT], const double weights[RESULT_COUNT],
                   double gradient[COLUMN_COUNT]);

#endif
