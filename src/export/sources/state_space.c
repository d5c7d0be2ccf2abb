/*
 * How long a step takes, in multiplications, additions and divisions: with fixed steps, always
 *
 *     S (4 E + 30 n + 20 m + 9) + 3
 *
 * and with error control, as long as no step is repeated,
 *
 *     S (6 E + 86 n + 30 m + 24) + E + 2 n + 5 m + 3
 *
 * with n states, m inputs that are driven, S = ceil(size of the step / model_solver_step) steps of four or six stages,
 * and E = L + N + G for a stage, which evaluates the functions. The dictionary takes, in L,
 *
 *     8 k        for an angle with the multiples up to k, besides one sine and one cosine,
 *     3 k + 2    for a column with the powers up to k > 0,
 *     f + 2 c    for a product of f factors in c functions.
 *
 * The network takes, in N,
 *
 *     5 for an angle, besides rounding down,
 *     2 for a column, besides a sine and a cosine of an angle,
 *     2 i o for a layer of i inputs and o nodes, rounded up to whole blocks of 16, besides activations: at most 50
 *       operations of activation.c for a node,
 *     3 for an output.
 *
 * A graph takes what graph.c says, and 1 for an output, in G.
 *
 * model_data.h has the number for a step of model_time_step. With error control as many steps are made as the
 * tolerance takes, ten million at most: where the time of a step must be bounded, export a model with fixed steps. When a host asks for outputs after the step, they are computed once: as
 * another stage, L + N + G, which without any state is all there is.
 */
#include "evaluator.h"

static const Real TAU = R(6.283185307179586476925286766559);

#define NUMBER Real
#define OF(name) real_##name
#define WORK RealWork
#include "dictionary.h"
#include "network_term.h"
#include "state_equations.h"
#undef NUMBER
#undef OF
#undef WORK

#define NUMBER Jet
#define OF(name) jet_##name
#define WORK JetWork
#include "dictionary.h"
#include "jet_activation.h"
#include "network_term.h"
#include "state_equations.h"
#undef NUMBER
#undef OF
#undef WORK

#ifdef METAFMU_SINGLE

bool model_goes_around(size_t state)
{
    return model_functions.columns[DICTIONARY_COLUMNS - STATE_COUNT + state].angle;
}

double model_turned(size_t result, const double turns[COLUMN_COUNT])
{
    const Given *given = &model_given[result];
    return given->state ? turns[INPUT_COUNT + given->index] : 0.0;
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

#if MODEL_HAS_STATES

void model_rates(Scratch *scratch, const Real point[COLUMN_COUNT], Real rates[STATE_COUNT],
                 Real arguments[ARGUMENT_SIZE])
{
    (void)arguments; /* there are no tables */
    real_compute(point, &scratch->real);
    for (size_t i = 0; i < STATE_COUNT; i++) {
        rates[i] = real_result(OUTPUT_COUNT + i, point, &scratch->real);
    }
}

Real model_share_of_step(const Scratch *scratch)
{
    (void)scratch;
    return R(1.0);
}

#endif
