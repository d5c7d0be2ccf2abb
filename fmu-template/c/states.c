/*
 * Cost of a step, in multiplications, additions and divisions. With fixed steps, it is always
 *
 *     S (4 E + 30 n + 20 m + 9) + 3 + H
 *
 * with error control, if no step is repeated,
 *
 *     S (6 E + 86 n + 30 m + 24) + E + 2 n + 5 m + 3 + H
 *
 * and with the implicit method
 *
 *     S ((8 + n) (E + 5 m) + 131 n + 18 n^2 + 2/3 n^3 + 24) + E + 5 m + 3 + H
 *
 * with n states, m driven inputs, and S = ceil(size of the step / model_solver_step) steps of four or six stages. E is
 * the cost of a stage, which runs the tape of the equations or functions. H is the cost of the operations that depend
 * on parameters alone, if these changed. tape.h has both. A network of a state space takes 5 for each angle, besides
 * rounding down. Its graph takes the cost in graph.c, and 1 for an output.
 *
 * model_data.h has the number for a step of model_time_step. Error control makes as many steps as the tolerance
 * requires, at most ten million. Where the time of a step must be bounded, export a model with fixed steps. Outputs
 * after a step are computed once, when a host reads them. The end of the step is a known stage; positions with their
 * derivatives, and reactions, are separate tapes.
 */
#include "evaluator.h"
#include <string.h>

#ifdef METAFMU_SINGLE

/* ---- Whole turns: taken off in double precision, since a state that goes around would lose its digits ---- */

static const double TAU = 6.283185307179586476925286766559;

/* Finds the turns of each column of a point, in rad; zero if the column is not an angle. */
static void find_turns(const double point[COLUMN_COUNT], double turns[COLUMN_COUNT])
{
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        const bool goes_around = i >= INPUT_COUNT && model_goes_around(i - INPUT_COUNT);
        turns[i] = goes_around ? TAU * floor(point[i] / TAU + 0.5) : 0.0;
    }
}

#endif

/* Converts a point to the numbers in which the model is computed. */
static void enter(const double point[COLUMN_COUNT], Real to[COLUMN_COUNT])
{
#ifdef METAFMU_SINGLE
    double turns[COLUMN_COUNT];
    find_turns(point, turns);
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        to[i] = (Real)(point[i] - turns[i]);
    }
#else
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        to[i] = point[i];
    }
#endif
}

/* ---- Results and their derivatives ---- */

void model_evaluate(Scratch *scratch, const double point[COLUMN_COUNT], double results[RESULT_COUNT])
{
    RealWork *work = &scratch->real;
    enter(point, work->point);
    model_respond(scratch);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        results[i] = (double)work->results[i];
    }
#ifdef METAFMU_SINGLE
    double turns[COLUMN_COUNT];
    find_turns(point, turns);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        results[i] += model_turned(i, turns);
    }
#endif
}

/* Returns the results at a point, with derivatives along a curve with the given rates. A null pointer means no second rates. */
static const Jet *follow(Scratch *scratch, const double point[COLUMN_COUNT], const double rates[COLUMN_COUNT],
                         const double *second_rates)
{
    JetWork *work = &scratch->jet;
    Real values[COLUMN_COUNT];
    enter(point, values);
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        work->point[i] = (Jet){values[i], (Real)rates[i], second_rates == NULL ? R(0.0) : (Real)second_rates[i]};
    }
    model_follow(scratch);
    return work->results;
}

void model_directional(Scratch *scratch, const double point[COLUMN_COUNT], const double direction[COLUMN_COUNT],
                       double derivative[RESULT_COUNT])
{
    const Jet *results = follow(scratch, point, direction, NULL);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        derivative[i] = (double)results[i].first;
    }
}

void model_along_curve(Scratch *scratch, const double point[COLUMN_COUNT], const double rates[COLUMN_COUNT],
                       const double second_rates[COLUMN_COUNT], double first[RESULT_COUNT],
                       double second[RESULT_COUNT])
{
    const Jet *results = follow(scratch, point, rates, second_rates);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        first[i] = (double)results[i].first;
        second[i] = (double)results[i].second;
    }
}

void model_adjoint(Scratch *scratch, const double point[COLUMN_COUNT], const double weights[RESULT_COUNT],
                   double gradient[COLUMN_COUNT])
{
    double direction[COLUMN_COUNT] = {0.0};
    for (size_t column = 0; column < COLUMN_COUNT; column++) {
        direction[column] = 1.0;
        const Jet *results = follow(scratch, point, direction, NULL);
        direction[column] = 0.0;
        Real sum = R(0.0);
        for (size_t i = 0; i < RESULT_COUNT; i++) {
            /* a weight of zero times an infinite derivative would be NaN */
            sum += weights[i] == 0.0 ? R(0.0) : (Real)weights[i] * results[i].first;
        }
        gradient[column] = (double)sum;
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

/* A Runge-Kutta method: times of the stages, weights of the previous stages for each stage, and weights of the result. */
typedef struct {
    size_t stages;
    Real times[SOLVER_STAGES];
    Real weights[SOLVER_STAGES][SOLVER_STAGES - 1];
    Real result[SOLVER_STAGES - 1];
} Method;

/* The classical method of order 4. */
static const Method CLASSICAL = {
    4,
    {R(0.0), R(0.5), R(0.5), R(1.0), R(0.0), R(0.0), R(0.0)},
    {{R(0.0)}, {R(0.5)}, {R(0.0), R(0.5)}, {R(0.0), R(0.0), R(1.0)}, {R(0.0)}, {R(0.0)}, {R(0.0)}},
    {R(1.0) / R(6.0), R(1.0) / R(3.0), R(1.0) / R(3.0), R(1.0) / R(6.0), R(0.0), R(0.0)},
};

/* Dormand, Prince (1980): order 5 with an embedded method of order 4. */
static const Method DORMAND_PRINCE = {
    SOLVER_STAGES,
    {R(0.0), R(0.2), R(0.3), R(0.8), R(8.0) / R(9.0), R(1.0), R(1.0)},
    {{R(0.0)},
     {R(0.2)},
     {R(3.0) / R(40.0), R(9.0) / R(40.0)},
     {R(44.0) / R(45.0), -R(56.0) / R(15.0), R(32.0) / R(9.0)},
     {R(19372.0) / R(6561.0), -R(25360.0) / R(2187.0), R(64448.0) / R(6561.0), -R(212.0) / R(729.0)},
     {R(9017.0) / R(3168.0), -R(355.0) / R(33.0), R(46732.0) / R(5247.0), R(49.0) / R(176.0), -R(5103.0) / R(18656.0)},
     {R(35.0) / R(384.0), R(0.0), R(500.0) / R(1113.0), R(125.0) / R(192.0), -R(2187.0) / R(6784.0), R(11.0) / R(84.0)}},
    {R(35.0) / R(384.0), R(0.0), R(500.0) / R(1113.0), R(125.0) / R(192.0), -R(2187.0) / R(6784.0), R(11.0) / R(84.0)},
};

#if !SOLVER_IS_IMPLICIT
/* Result of order 5 minus result of order 4. */
static const Real DORMAND_PRINCE_ERROR[SOLVER_STAGES] = {
    R(71.0) / R(57600.0), R(0.0), -R(71.0) / R(16695.0), R(71.0) / R(1920.0), -R(17253.0) / R(339200.0), R(22.0) / R(525.0), -R(1.0) / R(40.0),
};
#endif

/* Returns the rate of a state, weighted over the first `stages` stages. */
static Real weighted(const Scratch *scratch, const Real weights[], size_t stages, size_t state)
{
    Real sum = R(0.0);
    for (size_t i = 0; i < stages; i++) {
        sum += weights[i] * scratch->solver.rates[i][state];
    }
    return sum;
}

/* Begins a step. Columns that are neither inputs nor states keep their values. */
static void begin(Scratch *scratch)
{
    for (size_t i = 0; i < COLUMN_COUNT; i++) {
        scratch->solver.stage[i] = scratch->solver.point[i];
    }
}

/* Computes rates of the states at some stages of a step of size h, `since` seconds after the beginning. */
static void stages(Scratch *scratch, const Method *method, size_t first, size_t end, Real since, Real h)
{
    const Real *point = scratch->solver.point;
    Real *at = scratch->solver.stage;
    for (size_t stage = first; stage < end; stage++) {
        const Real later = since + method->times[stage] * h;
        for (size_t i = FIRST_DRIVEN; i < INPUT_COUNT; i++) {
            at[i] = driven(&scratch->solver.drives[i], later);
        }
        for (size_t i = 0; i < STATE_COUNT; i++) {
            at[INPUT_COUNT + i] = point[INPUT_COUNT + i] + h * weighted(scratch, method->weights[stage], stage, i);
        }
        model_rates(scratch, at, scratch->solver.rates[stage], scratch->solver.arguments[stage]);
    }
}

static void add_to_state(Scratch *scratch, size_t i, Real change)
{
    Real *state = &scratch->solver.point[INPUT_COUNT + i];
#ifdef METAFMU_SINGLE
    /* carry rounding errors over to the next sum (Kahan): in small steps they would add up to a drift */
    change += scratch->solver.lost[i];
    const Real sum = *state + change;
    scratch->solver.lost[i] = change - (sum - *state);
    *state = sum;
#else
    *state += change;
#endif
}

/* Checks that the states are plausible. */
static Advance check_states(const Scratch *scratch, Failure *failure)
{
    for (size_t i = 0; i < STATE_COUNT; i++) {
        const Real magnitude = MATH(fabs)(scratch->solver.point[INPUT_COUNT + i]);
        if (!(magnitude < REAL_HUGE)) {
            return ADVANCE_NOT_FINITE;
        }
        if (magnitude > (Real)model_scales[i].limit) {
            failure->state = i;
            failure->value = (double)scratch->solver.point[INPUT_COUNT + i];
            return ADVANCE_IMPLAUSIBLE;
        }
    }
    return ADVANCE_DONE;
}

/* Moves to the end of a step of size h, and checks that the states are plausible there. */
static Advance proceed(Scratch *scratch, const Real weights[], size_t count, Real h, Failure *failure)
{
    for (size_t i = 0; i < STATE_COUNT; i++) {
        add_to_state(scratch, i, h * weighted(scratch, weights, count, i));
    }
    return check_states(scratch, failure);
}

/* Returns the number of equal parts of a communication step, each at most as long as the longest step. */
static double parts(double size)
{
    /* rounding of the size must not cost a step */
    const double wanted = ceil(size / model_solver_step * (1.0 - 1e-9));
    return wanted > 1.0 ? wanted : 1.0;
}

static Advance advance_fixed(Scratch *scratch, const Step *step, Failure *failure)
{
    const double steps = parts(step->size);
    const Real h = (Real)(step->size / steps);
    Advance result = ADVANCE_DONE;
    if (steps > (double)MAX_STEPS) {
        return ADVANCE_TOO_MANY_STEPS;
    }
    for (uint32_t i = 0; result == ADVANCE_DONE && i < (uint32_t)steps; i++) {
        const Real since = (Real)i * h;
        begin(scratch);
        stages(scratch, &CLASSICAL, 0, CLASSICAL.stages, since, h);
        result = proceed(scratch, CLASSICAL.result, CLASSICAL.stages, h, failure);
        failure->after = (double)(since + h);
    }
    return result;
}

static bool is_nan(Real value)
{
    return !(value <= REAL_HUGE); /* not the macro, which warns of conversions on some platforms */
}

/* Returns the scale of the error of a step. */
static Real scale_of(const StateScale *scale, Real state)
{
    const Real nominal = (Real)scale->nominal;
    /* rounding of a large value is not an error of the step */
    const Real least = scale->relative ? MATH(fabs)(state) : REAL_EPSILON * MATH(fabs)(state);
    return nominal > least ? nominal : least;
}

#if SOLVER_IS_IMPLICIT
#include "rosenbrock.h"
#endif

/* Returns the largest estimate of a state's error in the step, relative to its scale. */
static Real error_of(const Scratch *scratch, Real h)
{
    Real error = R(0.0);
    for (size_t i = 0; i < STATE_COUNT; i++) {
        const Real scale = scale_of(&model_scales[i], scratch->solver.point[INPUT_COUNT + i]);
#if SOLVER_IS_IMPLICIT
        (void)h;
        const Real found = MATH(fabs)(scratch->solver.implicit.changes[IMPLICIT_STAGES - 1][i]) / scale;
#else
        const Real found = MATH(fabs)(h * weighted(scratch, DORMAND_PRINCE_ERROR, SOLVER_STAGES, i)) / scale;
#endif
        /* a maximum would ignore NaN */
        if (found > error || is_nan(found)) {
            error = found;
        }
    }
    return error;
}

/* Returns the ratio of the next step size to the present one, which had this error. NaN makes the next step as short as possible. */
static Real change_of_size(Real error)
{
    const Real factor = R(0.9) * MATH(pow)(error > R(1e-10) ? error : R(1e-10), -R(0.2));
    if (is_nan(error) || factor < R(0.1)) {
        return R(0.1);
    }
    return factor > R(5.0) ? R(5.0) : factor;
}

static double tolerance_of(const Step *step)
{
    const double wanted = step->tolerance;
    const double least = wanted > 0.0 && wanted < model_solver_tolerance ? wanted : model_solver_tolerance;
    return least > LEAST_TOLERANCE ? least : LEAST_TOLERANCE;
}

/* Makes a step of size h whose first rates are known. A repeated step has the same Jacobian. */
static void try_step(Scratch *scratch, Real since, Real h, bool is_repeated)
{
#if SOLVER_IS_IMPLICIT
    implicit_stages(scratch, since, h, is_repeated);
#else
    (void)is_repeated;
    stages(scratch, &DORMAND_PRINCE, 1, SOLVER_STAGES, since, h);
#endif
}

/* Moves to the end of a step of size h, where the next one begins, and checks that the states are plausible there. */
static Advance accept_step(Scratch *scratch, Real h, Failure *failure)
{
#if SOLVER_IS_IMPLICIT
    add_implicit_changes(scratch);
    begin(scratch);
    stages(scratch, &DORMAND_PRINCE, 0, 1, (Real)failure->after, R(0.0));
    (void)h;
    return check_states(scratch, failure);
#else
    const Advance result = proceed(scratch, DORMAND_PRINCE.result, SOLVER_STAGES - 1, h, failure);
    /* the last stage is the first of the next step */
    memcpy(scratch->solver.rates[0], scratch->solver.rates[SOLVER_STAGES - 1], sizeof scratch->solver.rates[0]);
    memcpy(scratch->solver.arguments[0], scratch->solver.arguments[SOLVER_STAGES - 1],
           sizeof scratch->solver.arguments[0]);
    return result;
#endif
}

/* Finds the rates of the states at the beginning of a communication step. */
static void find_first_rates(Scratch *scratch, const Step *step)
{
    /* the arguments are known, or there are none */
    const size_t arguments = ARGUMENT_COUNT;
    bool is_known = step->derivatives != NULL && (arguments == 0 || scratch->solver.is_at_end);
    for (size_t i = 0; is_known && arguments > 0 && i < COLUMN_COUNT; i++) {
        const Real at = scratch->solver.stage[i];
        is_known = at <= scratch->solver.point[i] && at >= scratch->solver.point[i];
    }
    scratch->solver.is_at_end = false;
    begin(scratch);
    if (!is_known) {
        stages(scratch, &DORMAND_PRINCE, 0, 1, R(0.0), R(0.0));
    }
    for (size_t i = 0; is_known && i < STATE_COUNT; i++) {
        scratch->solver.rates[0][i] = (Real)step->derivatives[i];
    }
}

static Advance advance_with_error_control(Scratch *scratch, const Step *step, Failure *failure)
{
    const double size = step->size;
    const double count = parts(size);
    const double longest = size / count;
    const Real tolerance = (Real)tolerance_of(step);
    double h = longest;
    uint32_t steps = 0;
    bool is_repeated = false;
    if (count > (double)MAX_STEPS) {
        return ADVANCE_TOO_MANY_STEPS;
    }
    find_first_rates(scratch, step);
    /* a remainder due to rounding is not a step */
    while (size - failure->after > SHORTEST * size) {
        const double rest = size - failure->after;
        steps++;
        if (steps > MAX_STEPS) {
            return ADVANCE_TOO_MANY_STEPS;
        }
        /* avoid a sliver at the end */
        if (h > 0.99 * rest) {
            h = rest;
        } else if (h > 0.5 * rest) {
            h = 0.5 * rest;
        }
        try_step(scratch, (Real)failure->after, (Real)h, is_repeated);
        is_repeated = true;
        bool has_bend;
        const double share = (double)model_share_of_step(scratch, &has_bend);
        if (share < 1.0 && share * h >= SHORTEST * size) {
            /* at most 0.9: otherwise the step might extend to the end of the communication step again */
            h *= share < 0.9 ? share : 0.9;
            continue;
        }
        const Real hidden = has_bend ? HIDDEN_BY_BEND : R(1.0);
        const Real error = hidden * error_of(scratch, (Real)h) / tolerance;
        if (error <= R(1.0)) {
            failure->after += h;
            is_repeated = false;
            const Advance result = accept_step(scratch, (Real)h, failure);
            if (result != ADVANCE_DONE) {
                return result;
            }
        }
        h *= (double)change_of_size(error);
        h = h < longest ? h : longest;
        if (h < SHORTEST * size) {
            return is_nan(error) ? ADVANCE_NOT_FINITE : ADVANCE_UNDERFLOW;
        }
    }
    scratch->solver.is_at_end = true;
    return ADVANCE_DONE;
}

Advance model_advance(Scratch *scratch, double point[COLUMN_COUNT], const Step *step, Failure *failure)
{
    Solver *solver = &scratch->solver;
    *failure = (Failure){0.0, 0, 0.0};
    enter(point, solver->point);
    for (size_t i = FIRST_DRIVEN; i < INPUT_COUNT; i++) {
        solver->drives[i] = drive_of(step, point, i);
    }
#ifdef METAFMU_SINGLE
    double turns[COLUMN_COUNT];
    find_turns(point, turns);
    for (size_t i = 0; i < STATE_COUNT; i++) {
        const size_t column = INPUT_COUNT + i;
        solver->lost[i] = (Real)(point[column] - turns[column] - (double)solver->point[column]);
    }
#endif
    const Advance result = model_solver_tolerance > 0.0 ? advance_with_error_control(scratch, step, failure)
                                                        : advance_fixed(scratch, step, failure);
    for (size_t i = INPUT_COUNT; result == ADVANCE_DONE && i < COLUMN_COUNT; i++) {
#ifdef METAFMU_SINGLE
        point[i] = turns[i] + ((double)solver->point[i] + (double)solver->lost[i - INPUT_COUNT]);
#else
        point[i] = solver->point[i];
#endif
    }
    return result;
}

#endif
