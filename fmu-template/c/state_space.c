/*
 * Cost of a step, in multiplications, additions and divisions. With fixed steps, it is always
 *
 *     S (4 G + 30 n + 20 m + 9) + 3
 *
 * and with error control, if no step is repeated,
 *
 *     S (6 G + 86 n + 30 m + 24) + G + 2 n + 5 m + 3
 *
 * with n states, m driven inputs, and S = ceil(size of the step / model_solver_step) steps of four or six stages. G is
 * the cost of a stage, which evaluates the graph (graph.c).
 *
 * model_data.h has the number for a step of model_time_step. Error control makes as many steps as the tolerance
 * requires, at most ten million. Where the time of a step must be bounded, export a model with fixed steps. When a host
 * reads outputs after the step, they are computed once, as another stage.
 */
#include "evaluator.h"

/* Returns the column of a point for a column of the graph, which lacks the starts before the driven inputs. */
static size_t place_of(size_t column)
{
    const size_t first_driven = FIRST_DRIVEN;
    return column + STATE_COUNT < first_driven ? column : column + STATE_COUNT;
}

void model_respond(Scratch *scratch)
{
    RealWork *work = &scratch->real;
    for (size_t i = 0; i < GRAPH_COLUMNS; i++) {
        work->graph[i] = work->point[place_of(i)];
    }
    real_graph(work->graph);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        work->results[i] = work->graph[NUMBER_COUNT - RESULT_COUNT + i];
    }
}

void model_follow(Scratch *scratch)
{
    JetWork *work = &scratch->jet;
    for (size_t i = 0; i < GRAPH_COLUMNS; i++) {
        work->graph[i] = work->point[place_of(i)];
    }
    jet_graph(work->graph);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        work->results[i] = work->graph[NUMBER_COUNT - RESULT_COUNT + i];
    }
}

void model_rates(Scratch *scratch, const Real point[COLUMN_COUNT], Real rates[STATE_COUNT],
                 Real arguments[ARGUMENT_SIZE])
{
    Real *graph = scratch->real.graph;
    (void)arguments; /* there are no tables */
    for (size_t i = 0; i < GRAPH_COLUMNS; i++) {
        graph[i] = point[place_of(i)];
    }
    real_graph(graph);
    for (size_t i = 0; i < STATE_COUNT; i++) {
        rates[i] = graph[NUMBER_COUNT - STATE_COUNT + i];
    }
}

Real model_share_of_step(const Scratch *scratch, bool *has_bend)
{
    (void)scratch;
    *has_bend = false;
    return R(1.0);
}

#ifdef METAFMU_SINGLE

bool model_goes_around(size_t state)
{
    return model_angles[state];
}

double model_turned(size_t result, const double turns[COLUMN_COUNT])
{
    const size_t state = model_given_states[result];
    return state < STATE_COUNT ? turns[INPUT_COUNT + state] : 0.0;
}

#endif
