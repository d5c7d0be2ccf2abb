/*
 * Common parts of all models with equations (states.c): derivatives of the results by jets and, with states, the
 * solver. A model computes its results at the point of its scratch, in real numbers and in jets, and the rates of its
 * states.
 */
#ifndef STATES_H
#define STATES_H

#include "model.h"

extern const double model_solver_step;      /* s; longest step of the solver */
extern const double model_solver_tolerance; /* of a step, relative to the scale of each state; zero for equal steps */

/* Scales of the values of a state. */
typedef struct {
    double nominal; /* scale of the error of a step */
    bool relative;  /* true if the scale is at least the state's magnitude */
    double limit;   /* magnitude beyond which no value is plausible */
} StateScale;

extern const StateScale model_scales[]; /* of each state */

enum { SOLVER_STAGES = 7 }; /* of the method of Dormand and Prince */

/* The stage of both methods that is nearest to the middle of the step and more accurate than the one before, and its time. */
enum { MIDDLE_STAGE = 2 };
#define MIDDLE_TIME (SOLVER_IS_IMPLICIT ? R(0.4095798393397535) : R(0.3))

#if SOLVER_IS_IMPLICIT

enum { IMPLICIT_STAGES = 8 }; /* of the method Rodas5P */

/* Working memory of the implicit method (rosenbrock.h). */
typedef struct {
    Real jacobian[STATE_COUNT][STATE_COUNT];
    Real factors[STATE_COUNT][STATE_COUNT]; /* of 1 / (gamma h) - J */
    size_t pivots[STATE_COUNT];
    Real by_time[STATE_COUNT]; /* derivative of the rates with respect to time */
    Real rates[STATE_COUNT];
    Real changes[IMPLICIT_STAGES][STATE_COUNT];
} Rosenbrock;

#endif

/* Working memory of a step. */
typedef struct {
    Real point[COLUMN_COUNT]; /* where the step has come to */
    Real stage[COLUMN_COUNT];
#if MODEL_HAS_STATES
    Real rates[SOLVER_STAGES][STATE_COUNT]; /* of the states at each stage */
    Drive drives[INPUT_COUNT];              /* of the inputs that are driven */
    Real arguments[SOLVER_STAGES][ARGUMENT_SIZE]; /* those with bends, at each stage */
    bool is_at_end; /* true if the last stage was the end of a communication step: its arguments are known */
#if SOLVER_IS_IMPLICIT
    Rosenbrock implicit;
#endif
#ifdef METAFMU_SINGLE
    Real lost[STATE_COUNT]; /* rounding errors of the states */
#endif
#endif
} Solver;

/* Shortest step of the solver, as a part of a communication step. */
#define SHORTEST 1e-14

/* Ratio of the error of a step over a bend to its estimate: both embedded results are wrong there in the same way. */
#define HIDDEN_BY_BEND R(30.0)

/* Least tolerance; smaller ones are replaced by it. */
#ifdef METAFMU_SINGLE
#define LEAST_TOLERANCE 1e-6
#else
#define LEAST_TOLERANCE 0.0
#endif

#endif
