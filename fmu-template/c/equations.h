/*
 * Template without an include guard: the equations of motion and the results in one kind of numbers. Define before
 * inclusion: NUMBER, their type; OF(name), the name of a function of them; WORK, their working memory; ALONG and
 * OF_ALONG(name), type and names for jets of them.
 */

/* Functions of two numbers other than sums and products. */
static NUMBER OF(combined)(Combination combination, NUMBER a, NUMBER b)
{
    switch (combination) {
    case COMBINATION_DIVIDE:
        return OF(quotient)(a, b);
    case COMBINATION_POWER:
        return OF(power)(a, b);
    case COMBINATION_ANGLE: {
        const Real y = OF(value)(a);
        const Real x = OF(value)(b);
        /* angle to the point, which changes with both coordinates; it has no derivatives at the origin */
        const NUMBER across = OF(difference)(OF(scaled)(a, x), OF(scaled)(b, y));
        const NUMBER ahead = OF(sum)(OF(scaled)(b, x), OF(scaled)(a, y));
        const NUMBER angle = OF(constant)(MATH(atan2)(y, x));
        return OF(value)(ahead) > R(0.0) ? OF(sum)(angle, OF(apply)(FUNCTION_ATAN, OF(quotient)(across, ahead))) : angle;
    }
    default:
        /* of equal numbers the one that is smaller an instant later */
        if (is_zero(OF(value)(b) - OF(value)(a))) {
            return OF(leading)(OF(difference)(b, a)) < R(0.0) ? b : a;
        }
        return OF(value)(b) < OF(value)(a) || isnan(OF(value)(b)) ? b : a;
    }
}

/* Runs an operation of formulas or of the solution of linear equations. */
static void OF(call)(const Operation *operation, NUMBER *registers)
{
    const NUMBER a = registers[operation->a];
    const NUMBER b = registers[operation->b];
    NUMBER *to = &registers[operation->to];
    switch (operation->kind) {
    case TAPE_RECIPROCAL:
        *to = OF(reciprocal)(OF(value)(a) > R(0.0) ? a : OF(constant)((Real)NAN));
        break;
    case TAPE_CALL:
        *to = OF(apply)((Function)operation->function, a);
        break;
    case TAPE_COMBINE:
        *to = OF(combined)((Combination)operation->function, a, b);
        break;
    default:
        *to = OF(lookup)(&model_tables[operation->data], a, b);
    }
}

#define CALL OF(call)
#include "tape_run.h"
#undef CALL

/* Evaluates the equations at a point. */
static void OF(accelerate)(const NUMBER point[COLUMN_COUNT], WORK *work)
{
    NUMBER inputs[EQUATION_INPUTS];
    memcpy(inputs, point + INPUT_COUNT, COORDINATE_COUNT * sizeof *inputs);
    memcpy(inputs + COORDINATE_COUNT, point, PARAMETER_COUNT * sizeof *inputs);
    memcpy(inputs + CONFIGURATION, point + INPUT_COUNT + COORDINATE_COUNT, COORDINATE_COUNT * sizeof *inputs);
    memcpy(inputs + CONFIGURATION + COORDINATE_COUNT, point + FIRST_DRIVEN, DRIVEN_COUNT * sizeof *inputs);
    memcpy(inputs + CONFIGURATION + COORDINATE_COUNT + DRIVEN_COUNT, point + INPUT_COUNT + 2 * COORDINATE_COUNT,
           ACTUATOR_STATES * sizeof *inputs);
    OF(run)(&model_equations, inputs, work->equations);
}

/* Returns a result of the equations. */
static NUMBER OF(found)(const WORK *work, size_t result)
{
    return work->equations[model_equations.results[result]];
}

/* Returns v^T M v / 2. */
static NUMBER OF(kinetic_energy)(const NUMBER v[COORDINATE_COUNT], const WORK *work)
{
    NUMBER energy = OF(constant)(R(0.0));
    size_t entry = FOUND_MASSES;
    for (size_t i = 0; i < COORDINATE_COUNT; i++) {
        for (size_t j = 0; j <= i; j++) {
            const NUMBER term = OF(product)(OF(product)(v[i], OF(found)(work, entry++)), v[j]);
            energy = OF(sum)(energy, OF(scaled)(term, i == j ? R(0.5) : R(1.0)));
        }
    }
    return energy;
}

/* Computes the results at the point of the working memory. */
static void OF(respond)(WORK *work)
{
    const size_t n = COORDINATE_COUNT;
    const size_t actuators = ACTUATOR_STATES;
    const NUMBER *q = work->point + INPUT_COUNT;
    const NUMBER *v = q + COORDINATE_COUNT;
    const NUMBER zero = OF(constant)(R(0.0));
    ALONG along[CONFIGURATION];
    NUMBER inputs[REACTION_INPUTS];
    OF(accelerate)(work->point, work);
    for (size_t i = 0; i < CONFIGURATION; i++) {
        along[i] = i < n ? (ALONG){q[i], v[i], OF(found)(work, i)} : (ALONG){work->point[i - n], zero, zero};
    }
    OF_ALONG(run)(&model_positions, along, work->positions);
    /* the energies */
    OF(perform)(&model_equations, 2, work->equations);
    /* (q, p, v), and accelerations and efforts */
    memcpy(inputs, work->equations, (CONFIGURATION + COORDINATE_COUNT) * sizeof *inputs);
    for (size_t i = 0; i < FOUND_MASSES; i++) {
        inputs[CONFIGURATION + COORDINATE_COUNT + i] = OF(found)(work, i);
    }
    OF(run)(&model_reactions, inputs, work->reactions);
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        const size_t which = model_shown[i].which;
        NUMBER *to = &work->results[i];
        switch (model_shown[i].kind) {
        case SHOWN_POSITION:
            *to = work->positions[model_positions.results[which]].value;
            break;
        case SHOWN_VELOCITY:
            *to = work->positions[model_positions.results[which]].first;
            break;
        case SHOWN_ACCELERATION:
            *to = work->positions[model_positions.results[which]].second;
            break;
        case SHOWN_KINETIC_ENERGY:
            *to = OF(kinetic_energy)(v, work);
            break;
        case SHOWN_POTENTIAL_ENERGY:
            *to = OF(found)(work, FOUND_POTENTIAL);
            break;
        case SHOWN_REACTION:
            *to = work->reactions[model_reactions.results[which]];
            break;
        case SHOWN_EFFORT:
            *to = OF(found)(work, n + which);
            break;
        }
    }
    for (size_t i = 0; i < n; i++) {
        work->results[OUTPUT_COUNT + i] = v[i];
        work->results[OUTPUT_COUNT + n + i] = OF(found)(work, i);
    }
    for (size_t i = 0; i < actuators; i++) {
        work->results[OUTPUT_COUNT + 2 * n + i] = OF(found)(work, FOUND_MASSES - actuators + i);
    }
}
