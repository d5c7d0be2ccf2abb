/*
 * Besides what the function takes, outputs take two multiplications, additions and divisions for each column and each
 * output.
 */
#include "evaluator.h"

#define NUMBER Real
#define OF(name) real_##name
#include FUNCTION_HEADER
#undef NUMBER
#undef OF

#define NUMBER Jet
#define OF(name) jet_##name
#include FUNCTION_HEADER
#undef NUMBER
#undef OF

void map_evaluate(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS], Real outputs[OUTPUT_COUNT])
{
    RealWork *work = &scratch->real;
    (void)map; /* there is one */
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        work->columns[i] = (columns[i] - model_input_scaling[i].mean) / model_input_scaling[i].scale;
    }
    real_function(work->columns, work->outputs, work->table);
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        outputs[i] = model_output_scaling[i].mean + model_output_scaling[i].scale * work->outputs[i];
    }
}

/* The function along a curve; without second rates where the pointer is null. */
static void follow(JetWork *work, const Real columns[MAP_COLUMNS], const Real rates[MAP_COLUMNS],
                   const Real *second_rates)
{
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        const Scaling *scaling = &model_input_scaling[i];
        const Real bend = second_rates == NULL ? R(0.0) : second_rates[i];
        work->columns[i] =
            (Jet){(columns[i] - scaling->mean) / scaling->scale, rates[i] / scaling->scale, bend / scaling->scale};
    }
    jet_function(work->columns, work->outputs, work->table);
}

void map_along_curve(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS],
                     const Real rates[MAP_COLUMNS], const Real *second_rates, Real first[OUTPUT_COUNT],
                     Real *second)
{
    JetWork *work = &scratch->jet;
    (void)map;
    follow(work, columns, rates, second_rates);
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        first[i] = work->outputs[i].first * model_output_scaling[i].scale;
        if (second != NULL) {
            second[i] = work->outputs[i].second * model_output_scaling[i].scale;
        }
    }
}

void map_adjoint(MapScratch *scratch, size_t map, const Real columns[MAP_COLUMNS],
                 const Real weights[OUTPUT_COUNT], Real gradient[MAP_COLUMNS])
{
    JetWork *work = &scratch->jet;
    Real rates[MAP_COLUMNS] = {R(0.0)};
    (void)map;
    for (size_t column = 0; column < MAP_COLUMNS; column++) {
        rates[column] = R(1.0);
        follow(work, columns, rates, NULL);
        rates[column] = R(0.0);
        gradient[column] = R(0.0);
        for (size_t i = 0; i < OUTPUT_COUNT; i++) {
            gradient[column] += weights[i] * model_output_scaling[i].scale * work->outputs[i].first;
        }
    }
}
