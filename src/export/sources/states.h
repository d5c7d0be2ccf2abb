/*
 * What all models of equations have in common (states.c): derivatives of the results by jets and, with states, the
 * solver. A model gives its results at the point of its scratch, in real numbers and in jets, and the rates of its
 * states.
 */
#ifndef STATES_H
#define STATES_H

#include "model.h"

extern const double model_solver_step; /* s; of the classical Runge-Kutta method at most */

enum { SOLVER_STAGES = 7 }; /* of the method of Dormand and Prince */

/* Working memory of a step: columns at a stage, the rates of the states at each stage, and the states before. */
typedef struct {
    double stage[COLUMN_COUNT];
#if MODEL_HAS_STATES
    double rates[SOLVER_STAGES][STATE_COUNT];
    double before[STATE_COUNT];
#endif
} Solver;

#endif
