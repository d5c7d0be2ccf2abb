/*
 * Evaluation of the surrogate: maps (maps.c), equations of motion (motion.c), other functions of states (state_space.c)
 * or of past samples (discrete.c). A point has one value for each input, followed by one for each state or by the
 * memory of a discrete-time model. Results are the outputs, followed by the derivatives of the states with respect to
 * time. No function allocates memory, or keeps anything between two calls outside of the scratch.
 */
#ifndef EVALUATOR_H
#define EVALUATOR_H

#include "model.h"

#include MODEL_HEADER

/*
 * Points, results and rates are in double precision here, even if the model is computed in single precision: between
 * two steps, a state keeps the digits that single precision would lose.
 */

/* Computes the results at a point. */
void model_evaluate(Scratch *scratch, const double point[COLUMN_COUNT], double results[RESULT_COUNT]);

/* Computes the derivative of the results in a direction: J direction. */
void model_directional(Scratch *scratch, const double point[COLUMN_COUNT], const double direction[COLUMN_COUNT],
                       double derivative[RESULT_COUNT]);

/* Computes the first and second derivatives of the results along a curve, given those of the columns. */
void model_along_curve(Scratch *scratch, const double point[COLUMN_COUNT], const double rates[COLUMN_COUNT],
                       const double second_rates[COLUMN_COUNT], double first[RESULT_COUNT],
                       double second[RESULT_COUNT]);

/* Computes the adjoint derivative: J^T weights. With states, it takes as long as a directional derivative for each column. */
void model_adjoint(Scratch *scratch, const double point[COLUMN_COUNT], const double weights[RESULT_COUNT],
                   double gradient[COLUMN_COUNT]);

#if MODEL_GOES_ON

/* Sets the states of a point, or its memory, to the start values among its inputs. */
void model_start(double point[COLUMN_COUNT]);

typedef enum {
    ADVANCE_DONE,
    ADVANCE_NOT_FINITE,     /* the model diverged, or a mass matrix is not positive definite */
    ADVANCE_TOO_MANY_STEPS, /* more than MAX_STEPS */
    ADVANCE_IMPLAUSIBLE,    /* a state is beyond its limit */
    ADVANCE_UNDERFLOW       /* no step is short enough for the tolerance */
} Advance;

/* Largest number of solver steps, or samples, in one communication step. */
enum { MAX_STEPS = 10000000 };

/* Settings of a step. */
typedef struct {
    double size;                /* s */
    double tolerance;           /* from the host, zero for none; it can only tighten that of the model */
    const double *derivatives;  /* of the states at the beginning, null if unknown */
    const double *rates;        /* of the inputs at the beginning, per s */
    const double *second_rates; /* of the inputs, per s^2 */
    bool clamp;                 /* true if inputs are clamped to their ranges during the step */
} Step;

/* Progress of a failed step. */
typedef struct {
    double after; /* s */
    size_t state; /* position of an implausible state among the states */
    double value; /* its value */
} Failure;

/*
 * Advances a point. The method of Dormand and Prince integrates continuous states, or Rodas5P with SOLVER_IS_IMPLICIT,
 * with local errors of at most model_solver_tolerance. If the tolerance is zero, the classical Runge-Kutta method makes
 * equal steps. No step is longer than model_solver_step. A discrete-time model advances to the next samples. On
 * failure, the point does not change.
 */
Advance model_advance(Scratch *scratch, double point[COLUMN_COUNT], const Step *step, Failure *failure);

/* Returns a driven input of a point. */
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

/* Returns true if a state is an angle in which the functions are periodic. */
bool model_goes_around(size_t state);

/* Returns the part of a result that is due to the turns taken off the columns, in rad. */
double model_turned(size_t result, const double turns[COLUMN_COUNT]);

#endif

/* Computes the results at the point of scratch->real. */
void model_respond(Scratch *scratch);

/* Computes the results in scratch->jet, with derivatives along the curve that the jets of its point describe. */
void model_follow(Scratch *scratch);

#endif

#if MODEL_HAS_STATES

/* Computes the rates of the states at a point, and the arguments with bends. */
void model_rates(Scratch *scratch, const Real point[COLUMN_COUNT], Real rates[STATE_COUNT],
                 Real arguments[ARGUMENT_SIZE]);

/* Returns the allowed share of a step of the solver, from 0 to 1, that does not step over a bend, and whether the step passes a bend. */
Real model_share_of_step(const Scratch *scratch, bool *has_bend);

#endif

#endif
