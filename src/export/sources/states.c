#include "evaluator.h"
#include <math.h>

/* ---- Results and their derivatives ---- */

void model_evaluate(Scratch *scratch, const double point[COLUMN_COUNT], double results[RESULT_COUNT])
{
    RealWork *work = &scratch->real;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        work->point[i] = point[i];
    }
    model_respond(scratch);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        results[i] = work->results[i];
    }
}

void model_directional(Scratch *scratch, const double point[COLUMN_COUNT], const double direction[COLUMN_COUNT],
                       double derivative[RESULT_COUNT])
{
    JetWork *work = &scratch->jet;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        work->point[i] = (Jet){point[i], direction[i], 0.0};
    }
    model_follow(scratch);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        derivative[i] = work->results[i].first;
    }
}

void model_along_curve(Scratch *scratch, const double point[COLUMN_COUNT], const double rates[COLUMN_COUNT],
                       const double second_rates[COLUMN_COUNT], double first[RESULT_COUNT],
                       double second[RESULT_COUNT])
{
    JetWork *work = &scratch->jet;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        work->point[i] = (Jet){point[i], rates[i], second_rates[i]};
    }
    model_follow(scratch);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        first[i] = work->results[i].first;
        second[i] = work->results[i].second;
    }
}

void model_adjoint(Scratch *scratch, const double point[COLUMN_COUNT], const double weights[RESULT_COUNT],
                   double gradient[COLUMN_COUNT])
{
    JetWork *work = &scratch->jet;
    for (size_t column = 0; column < COLUMN_COUNT; column++) {
        for (size_t i = 0; i < COLUMN_COUNT; i++) {
            work->point[i] = (Jet){point[i], i == column ? 1.0 : 0.0, 0.0};
        }
        model_follow(scratch);
        gradient[column] = 0.0;
        for (size_t i = 0; i < RESULT_COUNT; i++) {
            gradient[column] += weights[i] * work->results[i].first;
        }
    }
}

#if MODEL_HAS_STATES

/* ---- The solver ---- */

void model_start(double point[COLUMN_COUNT])
{
    size_t state = INPUT_COUNT;
    for (size_t i = 0; i < INPUT_COUNT; i++) {
        if (model_columns[i].role == ROLE_START) {
            point[state++] = point[i];
        }
    }
}

/* A Runge-Kutta method: each stage's time, its weights of the stages before it, and those of the result. */
typedef struct {
    size_t stages;
    double times[SOLVER_STAGES];
    double weights[SOLVER_STAGES][SOLVER_STAGES - 1];
    double result[SOLVER_STAGES - 1];
} Method;

/* The classical method of order 4. */
static const Method CLASSICAL = {
    4,
    {0.0, 0.5, 0.5, 1.0, 0.0, 0.0, 0.0},
    {{0.0}, {0.5}, {0.0, 0.5}, {0.0, 0.0, 1.0}, {0.0}, {0.0}, {0.0}},
    {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0, 0.0, 0.0},
};

/* Dormand, Prince (1980): order 5 with an embedded method of order 4. */
static const Method DORMAND_PRINCE = {
    SOLVER_STAGES,
    {0.0, 0.2, 0.3, 0.8, 8.0 / 9.0, 1.0, 1.0},
    {{0.0},
     {0.2},
     {3.0 / 40.0, 9.0 / 40.0},
     {44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0},
     {19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0},
     {9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0},
     {35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0}},
    {35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0},
};

/* Result of order 5 minus that of order 4. */
static const double DORMAND_PRINCE_ERROR[SOLVER_STAGES] = {
    71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339200.0, 22.0 / 525.0, -1.0 / 40.0,
};

/* The rate of a state, by the first so many stages. */
static double weighted(const Scratch *scratch, const double weights[], size_t stages, size_t state)
{
    double sum = 0.0;
    for (size_t i = 0; i < stages; i++) {
        sum += weights[i] * scratch->solver.rates[i][state];
    }
    return sum;
}

/* Rates of the states at the stages of a step of size h, `since` seconds after the beginning. */
static void stages(Scratch *scratch, const Method *method, const double point[COLUMN_COUNT], const Step *step,
                   double since, double h)
{
    double *at = scratch->solver.stage;
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        at[i] = point[i];
    }
    for (size_t stage = 0; stage < method->stages; stage++) {
        const double later = since + method->times[stage] * h;
        for (size_t i = FIRST_DRIVEN; i < INPUT_COUNT; i++) {
            at[i] = driven(step, point, i, later);
        }
        for (size_t i = 0; i < STATE_COUNT; i++) {
            at[INPUT_COUNT + i] = point[INPUT_COUNT + i] + h * weighted(scratch, method->weights[stage], stage, i);
        }
        model_rates(scratch, at, scratch->solver.rates[stage]);
    }
}

/* Goes to the end of a step of size h; whether all states are finite there. */
static bool proceed(const Scratch *scratch, const double weights[], size_t count, double h,
                    double point[COLUMN_COUNT])
{
    bool finite = true;
    for (size_t i = 0; i < STATE_COUNT; i++) {
        double *state = &point[INPUT_COUNT + i];
        *state += h * weighted(scratch, weights, count, i);
        finite = finite && fabs(*state) < HUGE_VAL;
    }
    return finite;
}

static Advance advance_fixed(Scratch *scratch, double point[COLUMN_COUNT], const Step *step, double *after)
{
    /* rounding of the size does not cost a step */
    const double wanted = ceil(step->size / model_solver_step * (1.0 - 1e-9));
    const double steps = wanted > 1.0 ? wanted : 1.0;
    const double h = step->size / steps;
    if (steps > MAX_STEPS) {
        return ADVANCE_TOO_MANY_STEPS;
    }
    for (uint32_t i = 0; i < (uint32_t)steps; i++) {
        const double since = (double)i * h;
        stages(scratch, &CLASSICAL, point, step, since, h);
        if (!proceed(scratch, CLASSICAL.result, CLASSICAL.stages, h, point)) {
            *after = since + h;
            return ADVANCE_NOT_FINITE;
        }
    }
    return ADVANCE_DONE;
}

static bool is_nan(double value)
{
    return !(value <= HUGE_VAL); /* not the macro, which warns of conversions on some platforms */
}

/* The local error of a step in units of what is tolerated. */
static double error_of(const Scratch *scratch, const double point[COLUMN_COUNT], double tolerance, double h)
{
    double error = 0.0;
    for (size_t i = 0; i < STATE_COUNT; i++) {
        const double magnitude = fabs(point[INPUT_COUNT + i]);
        const double nominal = model_columns[INPUT_COUNT + i].nominal;
        const double scale = tolerance * (magnitude > nominal ? magnitude : nominal);
        const double found = fabs(h * weighted(scratch, DORMAND_PRINCE_ERROR, SOLVER_STAGES, i)) / scale;
        /* a maximum would leave out what is not a number */
        if (found > error || is_nan(found)) {
            error = found;
        }
    }
    return error;
}

/* By what the next step is longer than one with this error; one that is not a number makes it as short as possible. */
static double change_of_size(double error)
{
    const double factor = 0.9 * pow(error > 1e-10 ? error : 1e-10, -0.2);
    if (is_nan(error) || factor < 0.1) {
        return 0.1;
    }
    return factor > 5.0 ? 5.0 : factor;
}

static Advance advance_adaptive(Scratch *scratch, double point[COLUMN_COUNT], const Step *step, double *after)
{
    const double size = step->size;
    double h = size < model_solver_step ? size : model_solver_step;
    double steps = 0.0;
    *after = 0.0;
    /* what is left by rounding is no step */
    while (size - *after > 1e-14 * size) {
        const double rest = size - *after;
        steps += 1.0;
        if (steps > MAX_STEPS) {
            return ADVANCE_TOO_MANY_STEPS;
        }
        /* no sliver at the end */
        if (h > 0.99 * rest) {
            h = rest;
        } else if (h > 0.5 * rest) {
            h = 0.5 * rest;
        }
        stages(scratch, &DORMAND_PRINCE, point, step, *after, h);
        const double error = error_of(scratch, point, step->tolerance, h);
        if (error <= 1.0) {
            *after += h;
            if (!proceed(scratch, DORMAND_PRINCE.result, SOLVER_STAGES - 1, h, point)) {
                return ADVANCE_NOT_FINITE;
            }
        }
        h *= change_of_size(error);
        if (h < 1e-14 * size) {
            return ADVANCE_NOT_FINITE;
        }
    }
    return ADVANCE_DONE;
}

Advance model_advance(Scratch *scratch, double point[COLUMN_COUNT], const Step *step, double *after)
{
    for (size_t i = 0; i < STATE_COUNT; i++) {
        scratch->solver.before[i] = point[INPUT_COUNT + i];
    }
    const Advance result = step->tolerance > 0.0 ? advance_adaptive(scratch, point, step, after)
                                                 : advance_fixed(scratch, point, step, after);
    for (size_t i = 0; result != ADVANCE_DONE && i < STATE_COUNT; i++) {
        point[INPUT_COUNT + i] = scratch->solver.before[i];
    }
    return result;
}

#endif
