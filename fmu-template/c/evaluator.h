/*
 * What computes the surrogate: maps (maps.c), equations of motion (motion.c), other functions of states (state_space.c)
 * or of past samples (discrete.c). A point has one value for each input and, after them, one for each
 * state, or what a model of samples remembers; results are the outputs and, after them, the states' derivatives with
 * respect to time. Nothing here allocates or keeps anything between two calls but in the scratch.
 */
#ifndef EVALUATOR_H
#define EVALUATOR_H

#include "model.h"

#include MODEL_HEADER

/*
 * Points, results and rates are in double precision here, whatever the model is computed in: a state keeps what single
 * precision would take off it between two steps.
 */

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

#if MODEL_GOES_ON

/* Gives the states of a point, or what is remembered, the values that its inputs have for the start. */
void model_start(double point[COLUMN_COUNT]);

typedef enum {
    ADVANCE_DONE,
    ADVANCE_NOT_FINITE,     /* the model diverged, or a mass matrix is not positive definite */
    ADVANCE_TOO_MANY_STEPS, /* more than MAX_STEPS */
    ADVANCE_IMPLAUSIBLE,    /* a state is beyond its limit */
    ADVANCE_UNDERFLOW       /* no step is short enough for the tolerance */
} Advance;

/* Steps of the solver, or from sample to sample, in one communication step at most. */
enum { MAX_STEPS = 10000000 };

/* What a step is to do. */
typedef struct {
    double size;                /* s */
    double tolerance;           /* that the host wants, zero for none; it can only tighten that of the model */
    const double *derivatives;  /* of the states at the beginning, if they are known, else null */
    const double *rates;        /* of the inputs at the beginning, per s */
    const double *second_rates; /* per s^2 */
    bool clamp;                 /* whether inputs are clamped to their ranges on the way */
} Step;

/* How far a step came that was not made. */
typedef struct {
    double after; /* s */
    size_t state; /* of an implausible state, its position among the states */
    double value; /* and what it is */
} Failure;

/*
 * Goes on from a point. Continuous states are integrated by the method of Dormand and Prince, with SOLVER_IS_IMPLICIT by
 * Rodas5P, whose local errors are at most model_solver_tolerance. If that is zero, the classical Runge-Kutta method makes
 * equal steps. No step is longer than model_solver_step. A model of samples advances to the next ones. If that fails,
 * the point is as before.
 */
Advance model_advance(Scratch *scratch, double point[COLUMN_COUNT], const Step *step, Failure *failure);

/* A driven input of a point. */
static inline Drive drive_of(const Step *step, const double point[COLUMN_COUNT], size_t input)
{
    const Column *column = &model_columns[input];
    const Real width = MODEL_HAS_EQUATIONS ? (Real)column->max - (Real)column->min : R(0.0);
    const Drive drive = {(Real)point[input],
                         (Real)step->rates[input],
                         (Real)step->second_rates[input],
                         step->clamp ? (Real)column->min : -REAL_HUGE,
                         step->clamp ? (Real)column->max : REAL_HUGE,
                         {(Real)column->min, (Real)column->max},
                         width * (R(4.0) * REAL_EPSILON > R(1e-9) ? R(4.0) * REAL_EPSILON : R(1e-9))};
    return drive;
}

#endif

#if MODEL_HAS_EQUATIONS

#ifdef METAFMU_SINGLE

/* Whether a state is an angle, of which the functions are periodic. */
bool model_goes_around(size_t state);

/* What turns that are taken off the columns, in rad, take off a result. */
double model_turned(size_t result, const double turns[COLUMN_COUNT]);

#endif

/* Puts the results at the point of scratch->real there. */
void model_respond(Scratch *scratch);

/* The same in scratch->jet, with derivatives along the curve that the point's jets are. */
void model_follow(Scratch *scratch);

#endif

#if MODEL_HAS_STATES

/* The rates of the states at a point, and arguments of tables. */
void model_rates(Scratch *scratch, const Real point[COLUMN_COUNT], Real rates[STATE_COUNT],
                 Real arguments[ARGUMENT_SIZE]);

/* Share of a step of the solver, from 0 to 1, with which no table is stepped over. */
Real model_share_of_step(const Scratch *scratch);

#endif

#endif
