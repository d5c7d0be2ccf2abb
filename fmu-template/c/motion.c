#include "evaluator.h"

/* Runs splines, the only operations from TAPE_RECIPROCAL on that positions use. */
static void nested_call(const Operation *operation, Nested *registers)
{
    registers[operation->to] = nested_lookup(&model_tables[operation->data], registers[operation->a]);
}

#define NUMBER Nested
#define OF(name) nested_##name
#define CALL nested_call
#include "activation_formulas.h"
#include "tape_run.h"
#undef NUMBER
#undef OF
#undef CALL

#define NUMBER Jet
#define OF(name) jet_##name
#define WORK JetWork
#define ALONG Nested
#define OF_ALONG(name) nested_##name
#include "activation_formulas.h"
#include "equations.h"
#undef NUMBER
#undef OF
#undef WORK
#undef ALONG
#undef OF_ALONG

#define NUMBER Real
#define OF(name) real_##name
#define WORK RealWork
#define ALONG Jet
#define OF_ALONG(name) jet_##name
#include "equations.h"

#ifdef METAFMU_SINGLE

bool model_goes_around(size_t state)
{
    return state < COORDINATE_COUNT && model_periodic[state];
}

double model_turned(size_t result, const double turns[COLUMN_COUNT])
{
    double turned = 0.0;
    if (result >= OUTPUT_COUNT || model_shown[result].kind != SHOWN_POSITION) {
        return turned;
    }
    for (size_t k = 0; k < COORDINATE_COUNT; k++) {
        turned += (double)model_windings[model_shown[result].which * COORDINATE_COUNT + k] * turns[INPUT_COUNT + k];
    }
    return turned;
}

#endif

void model_respond(Scratch *scratch)
{
    real_respond(&scratch->real);
}

void model_follow(Scratch *scratch)
{
    jet_respond(&scratch->jet);
}

void model_rates(Scratch *scratch, const Real point[COLUMN_COUNT], Real rates[STATE_COUNT],
                 Real arguments[ARGUMENT_SIZE])
{
    const size_t count = ARGUMENT_COUNT;
    const size_t actuators = ACTUATOR_STATES;
    real_accelerate(point, &scratch->real);
    for (size_t i = 0; i < COORDINATE_COUNT; i++) {
        rates[i] = point[INPUT_COUNT + COORDINATE_COUNT + i];
        rates[COORDINATE_COUNT + i] = real_found(&scratch->real, i);
    }
    for (size_t i = 0; i < actuators; i++) {
        rates[2 * COORDINATE_COUNT + i] = real_found(&scratch->real, FOUND_MASSES - actuators + i);
    }
    for (size_t i = 0; i < count; i++) {
        arguments[i] = scratch->real.equations[model_arguments[i].of];
    }
}

/* Parts of the distance to a bend that a step may cover; the second one if the argument turns at the bend. */
#define APPROACH R(0.9)
#define APPROACH_OF_TURN R(0.45)
/* Share of a step in which an argument turns from which on the distance to the bend does not matter. */
#define NEAR_TURN R(1e-3)
/* Part of the distance to a turn by which the estimate of the turn may be off. */
#define UNCERTAIN R(0.05)
/* Shares of a step whose difference is rounding. */
#define COINCIDENT (R(1e-9) > R(8.0) * REAL_EPSILON ? R(1e-9) : R(8.0) * REAL_EPSILON)

/* Values of an argument during a step. */
typedef struct {
    Real start;
    Real end;
    Real lowest;
    Real highest;
} Path;

static Real smaller(Real a, Real b)
{
    return a < b ? a : b;
}

static Real larger(Real a, Real b)
{
    return a > b ? a : b;
}

/* Adds the value at which a path turns, if it does: that of a parabola through both ends and the value at a share of the step. */
static void add_turn(Path *path, Real share, Real value)
{
    const Real moved = path->end - path->start;
    const Real part = value - path->start;
    const Real curvature = (part - share * moved) / (share * share - share);
    const Real slope = moved - curvature;
    const Real turn = R(-0.5) * slope / curvature;
    if (turn > R(0.0) && turn < R(1.0)) {
        const Real height = R(0.5) * slope * turn;
        const Real margin = UNCERTAIN * smaller(MATH(fabs)(height), MATH(fabs)(height - moved));
        const Real reached = path->start + height + (curvature > R(0.0) ? -margin : margin);
        path->lowest = smaller(path->lowest, reached);
        path->highest = larger(path->highest, reached);
    }
}

static Path path_of(const Scratch *scratch, size_t argument)
{
    const Real start = scratch->solver.arguments[0][argument];
    Path path = {start, scratch->solver.arguments[SOLVER_STAGES - 1][argument], start, start};
    for (size_t stage = 1; stage < SOLVER_STAGES; stage++) {
        path.lowest = smaller(path.lowest, scratch->solver.arguments[stage][argument]);
        path.highest = larger(path.highest, scratch->solver.arguments[stage][argument]);
    }
    add_turn(&path, MIDDLE_TIME, scratch->solver.arguments[MIDDLE_STAGE][argument]);
    return path;
}

/* Finds the next bend on a path from a place on: bends of the period in which the path begins, then those of the next one. */
static bool next_bend(const Argument *argument, const Path *path, size_t *place, Bend *bend)
{
    const bool is_periodic = argument->period > R(0.0);
    const Real first = is_periodic ? MATH(floor)((path->lowest - argument->start) / argument->period) : R(0.0);
    const size_t end = is_periodic ? 2 * argument->count : argument->count;
    while (*place < end) {
        const size_t i = *place;
        const Real turns = first + (i < argument->count ? R(0.0) : R(1.0));
        *bend = argument->bends[i % argument->count];
        bend->at += turns * argument->period;
        *place = i + 1;
        if (bend->at >= path->lowest && bend->at <= path->highest) {
            return true;
        }
    }
    return false;
}

/* Returns the share of the way up to a value. */
static Real share_up_to(const Path *path, Real value)
{
    return MATH(fabs)(value - path->start) / (path->highest - path->lowest);
}

/* Returns the share of the step that passes a bend in short steps, after few steps up to there. */
static Real share_at(const Path *path, const Bend *bend)
{
    const Real up_to = share_up_to(path, bend->at);
    const Real share = larger(bend->width / (path->highest - path->lowest), APPROACH * up_to);
    const bool is_above = bend->at > path->start && bend->at > path->end;
    const bool is_below = bend->at < path->start && bend->at < path->end;
    /* passed twice: there and back again */
    return is_above || is_below ? smaller(share, larger(NEAR_TURN, APPROACH_OF_TURN * up_to)) : share;
}

/* Returns the share of a step that does not pass two bends of a function, one of which is reached at a share of the step. */
static Real share_between(const Scratch *scratch, size_t argument, Real up_to)
{
    Real share = R(1.0);
    for (size_t i = 0; i < argument; i++) {
        if (model_arguments[i].group != model_arguments[argument].group) {
            continue;
        }
        const Path path = path_of(scratch, i);
        Bend bend;
        for (size_t place = 0; next_bend(&model_arguments[i], &path, &place, &bend);) {
            const Real before = share_up_to(&path, bend.at);
            const Real between = MATH(fabs)(before - up_to);
            if (between > COINCIDENT) {
                share = smaller(share, larger(between, APPROACH * smaller(before, up_to)));
            }
        }
    }
    return share;
}

Real model_share_of_step(const Scratch *scratch, bool *has_bend)
{
    const size_t count = ARGUMENT_COUNT;
    Real share = R(1.0);
    *has_bend = false;
    for (size_t i = 0; i < count; i++) {
        const Path path = path_of(scratch, i);
        Bend bend;
        for (size_t place = 0; next_bend(&model_arguments[i], &path, &place, &bend);) {
            *has_bend = true;
            share = smaller(share, share_at(&path, &bend));
            share = smaller(share, share_between(scratch, i, share_up_to(&path, bend.at)));
        }
    }
    return share;
}
