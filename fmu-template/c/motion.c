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

/*
 * Returns the allowed share of a step in which an argument moves between two values. Across a bend, it may move by at
 * most the bend's width.
 */
static Real share_over_bends(const Argument *argument, Real start, Real lowest, Real highest)
{
    const LookupTable *table = argument->table;
    const Real *knots = argument->axis > 0 ? table->y : table->x;
    const size_t count = argument->axis > 0 ? table->y_count : table->x_count;
    const int is_periodic = table->extrapolation == EXTRAPOLATION_PERIODIC;
    const Real period = knots[count - 1] - knots[0];
    Real shift = is_periodic ? MATH(floor)((lowest - knots[0]) / period) * period : R(0.0);
    Real share = R(1.0);
    /* the period in which the argument begins to move, and the next one */
    for (int turn = 0; turn <= is_periodic; turn++) {
        for (size_t i = 0; i < table->bend_counts[argument->axis]; i++) {
            const Bend *bend = &table->bends[argument->axis][i];
            const Real at = bend->at + shift;
            if (at < lowest || at > highest) {
                continue;
            }
            const Real distance = R(0.9) * MATH(fabs)(at - start);
            const Real allowed = (distance > bend->width ? distance : bend->width) / (highest - lowest);
            share = allowed < share ? allowed : share;
        }
        shift += period;
    }
    return share;
}

Real model_share_of_step(const Scratch *scratch)
{
    const size_t count = ARGUMENT_COUNT;
    Real share = R(1.0);
    for (size_t i = 0; i < count; i++) {
        Real lowest = scratch->solver.arguments[0][i];
        Real highest = lowest;
        for (size_t stage = 1; stage < SOLVER_STAGES; stage++) {
            const Real at = scratch->solver.arguments[stage][i];
            lowest = at < lowest ? at : lowest;
            highest = at > highest ? at : highest;
        }
        const Real found = share_over_bends(&model_arguments[i], scratch->solver.arguments[0][i], lowest, highest);
        share = found < share ? found : share;
    }
    return share;
}
