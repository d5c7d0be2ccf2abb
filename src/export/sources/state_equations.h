/*
 * A template, without a guard: the functions and results of a state space in one kind of numbers. Before it is
 * included, NUMBER is their type, OF(name) the name of a function of them and WORK their working memory.
 */

/* The functions at a point. */
static void OF(compute)(const NUMBER point[COLUMN_COUNT], WORK *work)
{
    NUMBER *columns = work->columns;
    const size_t first_driven = FIRST_DRIVEN;
    for (size_t i = 0; i < DICTIONARY_COLUMNS; i++) {
        /* without the starts, which are before the inputs that are driven */
        columns[i] = point[i + STATE_COUNT < first_driven ? i : i + STATE_COUNT];
    }
    OF(dictionary)(&model_functions, columns, work->functions, NULL, 0, work->atoms, work->slopes);
#if MODEL_HAS_GRAPH
    for (size_t i = 0; i < DICTIONARY_COLUMNS; i++) {
        work->graph[i] = columns[i];
    }
    OF(graph)(work->graph);
    for (size_t i = 0; i < FUNCTION_SIZE; i++) {
        work->functions[i] = OF(sum)(work->functions[i], work->graph[NUMBER_COUNT - FUNCTION_SIZE + i]);
    }
#endif
    if (model_functions_network.layer_count == 0) {
        return;
    }
    for (size_t i = 0; i < DICTIONARY_COLUMNS; i++) {
        if (model_functions.columns[i].angle) {
            /* whole turns are taken off, so that a turn later the network's columns are the very same */
            const Real value = OF(value)(columns[i]);
            const Real turns = value / TAU;
            const NUMBER change = OF(difference)(columns[i], OF(constant)(value));
            columns[i] = OF(sum)(OF(constant)(TAU * (turns - MATH(floor)(turns))), change);
        }
    }
    OF(add_network)(&model_functions_network, columns, work->functions, NULL, 0, work->network);
}

/* A result, once the functions at the point were computed. */
static NUMBER OF(result)(size_t index, const NUMBER point[COLUMN_COUNT], const WORK *work)
{
    const Given *given = &model_given[index];
    return given->state ? point[INPUT_COUNT + given->index] : work->functions[given->index];
}

/* The results at the point of the working memory. */
static void OF(respond)(WORK *work)
{
    OF(compute)(work->point, work);
    for (size_t i = 0; i < RESULT_COUNT; i++) {
        work->results[i] = OF(result)(i, work->point, work);
    }
}
