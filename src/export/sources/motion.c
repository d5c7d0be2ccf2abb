/*
 * How long a step takes, in multiplications, additions and divisions: with fixed steps, always
 *
 *     S (4 E + 60 n + 20 m + 9) + 3
 *
 * and with error control, as long as no step is repeated,
 *
 *     S (6 E + 172 n + 30 m + 24) + E + 4 n + 5 m + 3
 *
 * with n coordinates, m inputs, e efforts, S = ceil(size of the step / model_solver_step) steps of four or six stages, and
 *
 *     E = L + N + A + n (1 + 2 n + 5 n^2 + 2 e) + n (n + 1) (2 n + 1) / 6 + n (2 n - 1)
 *
 * for a stage, which evaluates the law with its gradient, forms the right-hand side, factorises the mass matrix and
 * substitutes. The law takes, in L,
 *
 *     8 k        for an angle with the multiples up to k, besides one sine and one cosine,
 *     3 k + 2    for a column with the powers up to k > 0,
 *     f + 2 c + g (f - 1 + 2 c)    for a product of f factors, g of them of coordinates, in c functions.
 *
 * Efforts take, in A, 5 n for a position with its rate, and 1 for an operation of a formula, besides its functions.
 * Networks take, in N, with d = n derivatives in the law and none in the forces,
 *
 *     2 + d                for a column, besides a sine and a cosine of an angle,
 *     2 (1 + d) i o        for a layer of i inputs and o nodes, rounded up to whole blocks of 16,
 *     d                    for a node, besides its activation: with its slope at most 70 operations of activation.c,
 *     3 + 2 d              for an output.
 *
 * A prescribed acceleration takes less: 2 n for the other coordinates, instead of 5 n^2 + 1 for its own.
 *
 * model_data.h has the number for a step of model_time_step. With error control as many steps are made as the
 * tolerance takes, ten million at most: where the time of a step must be bounded, export a model with fixed steps. When a host asks for outputs after the step, they are computed once: as
 * another stage, the positions with their derivatives, and the reactions.
 */
#include "evaluator.h"

/* Position of M_ij in the lower triangle. */
static size_t entry(size_t i, size_t j)
{
    const size_t row = i > j ? i : j;
    const size_t column = i > j ? j : i;
    return row * (row + 1) / 2 + column;
}

#define NUMBER Real
#define OF(name) real_##name
#include "dictionary.h"
#include "network_term.h"
#undef NUMBER
#undef OF

#define NUMBER Jet
#define OF(name) jet_##name
#include "dictionary.h"
#include "jet_activation.h"
#include "network_term.h"
#undef NUMBER
#undef OF

#define NUMBER Nested
#define OF(name) nested_##name
#include "dictionary.h"
#include "jet_activation.h"
#include "network_term.h"
#undef NUMBER
#undef OF

#define NUMBER Real
#define OF(name) real_##name
#define WORK RealWork
#define ALONG Jet
#define OF_ALONG(name) jet_##name
#include "equations.h"
#undef NUMBER
#undef OF
#undef WORK
#undef ALONG
#undef OF_ALONG

#define NUMBER Jet
#define OF(name) jet_##name
#define WORK JetWork
#define ALONG Nested
#define OF_ALONG(name) nested_##name
#include "equations.h"
#undef NUMBER
#undef OF
#undef WORK
#undef ALONG
#undef OF_ALONG

#ifdef METAFMU_SINGLE

bool model_goes_around(size_t state)
{
    return state < COORDINATE_COUNT && model_law.columns[state].angle && model_periodic[state];
}

double model_turned(size_t result, const double turns[COLUMN_COUNT])
{
    double turned = 0.0;
    if (result >= OUTPUT_COUNT || model_shown[result].kind != SHOWN_POSITION) {
        return turned;
    }
    for (size_t k = 0; k < COORDINATE_COUNT; k++) {
        turned += (double)model_windings[model_shown[result].position * COORDINATE_COUNT + k] * turns[INPUT_COUNT + k];
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
    real_accelerate(point, &scratch->real);
    for (size_t i = 0; i < COORDINATE_COUNT; i++) {
        rates[i] = point[INPUT_COUNT + COORDINATE_COUNT + i];
        rates[COORDINATE_COUNT + i] = scratch->real.accelerations[i];
    }
    for (size_t i = 0; i < count; i++) {
        arguments[i] = scratch->real.arguments[i];
    }
}

/* Share of a step on whose way an argument is between two values: over a bend it may move by no more than its width. */
static Real share_over_bends(const Argument *argument, Real start, Real lowest, Real highest)
{
    const LookupTable *table = argument->table;
    const Real *knots = argument->axis > 0 ? table->y : table->x;
    const size_t count = argument->axis > 0 ? table->y_count : table->x_count;
    const int is_periodic = table->extrapolation == EXTRAPOLATION_PERIODIC;
    const Real period = knots[count - 1] - knots[0];
    Real shift = is_periodic ? MATH(floor)((lowest - knots[0]) / period) * period : R(0.0);
    Real share = R(1.0);
    /* the period in which the movement begins, and the next one */
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
