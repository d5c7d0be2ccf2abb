/*
 * States x, which may be none, whose derivatives are any functions of parameters p, inputs u and states:
 *
 *     xd = f(p, u, x)
 *     y = g(p, u, x)
 *
 * The inputs of a point are p, the starts of x, u; its states are x. Each of the results y, xd is a state itself, as
 * the derivative of a position is, or one of the functions that were learned: a dictionary of the columns (p, u, x), to
 * which a network may add, or a graph of another tool (graph.c).
 */
#ifndef STATE_SPACE_H
#define STATE_SPACE_H

#include "functions.h"
#include "jets.h"
#include "model.h"
#include "states.h"

#if MODEL_HAS_GRAPH
#include "graph.h"
#define GRAPH_WORK(Number) Number graph[NUMBER_COUNT];
#else
#define GRAPH_WORK(Number)
#endif

/* What a result is. */
typedef struct {
    bool state; /* a state; else one of the functions */
    size_t index;
} Given;

extern const Dictionary model_functions;
extern const NetworkTerm model_functions_network;
extern const Given model_given[RESULT_COUNT];

/* Working memory of an evaluation in one kind of numbers. */
#define STATE_SPACE_WORK(Name, Number)      \
    typedef struct {                        \
        Number point[COLUMN_COUNT];         \
        Number results[RESULT_COUNT];       \
        Number columns[DICTIONARY_COLUMNS]; \
        Number atoms[ATOM_COUNT];           \
        Number slopes[ATOM_COUNT];          \
        Number network[2 * NETWORK_WIDTH];  \
        Number functions[FUNCTION_SIZE];    \
        GRAPH_WORK(Number)                  \
    } Name

STATE_SPACE_WORK(RealWork, Real);
STATE_SPACE_WORK(JetWork, Jet);

/* Working memory of one evaluation at a time. */
typedef struct {
    RealWork real;
    JetWork jet;
    Solver solver;
} Scratch;

#endif
