/*
 * A template, without a guard: the equations of motion and the results in one kind of numbers. Before it is included,
 * NUMBER is their type, OF(name) the name of a function of them and WORK their working memory; ALONG and OF_ALONG(name)
 * are type and names for jets of them.
 */

/*
 * M = L D L^T: L below the diagonal of factors, 1 / D on it; NaN where a pivot is not positive. Rows and columns of what
 * is prescribed are those of the identity.
 */
static void OF(factorise)(const NUMBER mass[], NUMBER factors[COORDINATE_COUNT * COORDINATE_COUNT])
{
    const size_t n = COORDINATE_COUNT;
    for (size_t i = 0; i < n; i++) {
        for (size_t j = 0; j <= i; j++) {
            const int is_free = !model_prescribed[i] && !model_prescribed[j];
            NUMBER value = is_free ? mass[entry(i, j)] : OF(constant)(i == j ? R(1.0) : R(0.0));
            for (size_t k = 0; k < j; k++) {
                /* above the diagonal are the elements of L D */
                value = OF(difference)(value, OF(product)(factors[i * n + k], factors[k * n + j]));
            }
            if (j < i) {
                factors[j * n + i] = value;
                factors[i * n + j] = OF(product)(value, factors[j * n + j]);
            } else {
                factors[i * n + i] = OF(reciprocal)(OF(value)(value) > R(0.0) ? value : OF(constant)(NAN));
            }
        }
    }
}

/* x in place of b with L D L^T x = b. */
static void OF(substitute)(const NUMBER factors[COORDINATE_COUNT * COORDINATE_COUNT], NUMBER x[COORDINATE_COUNT])
{
    const size_t n = COORDINATE_COUNT;
    for (size_t i = 0; i < n; i++) {
        for (size_t j = 0; j < i; j++) {
            x[i] = OF(difference)(x[i], OF(product)(factors[i * n + j], x[j]));
        }
    }
    for (size_t i = n; i-- > 0;) {
        x[i] = OF(product)(x[i], factors[i * n + i]);
        for (size_t j = i + 1; j < n; j++) {
            x[i] = OF(difference)(x[i], OF(product)(factors[j * n + i], x[j]));
        }
    }
}

/* dM_ij/dq_k - dM_jk/dq_i / 2 */
static NUMBER OF(velocity_term)(const NUMBER gradient[], size_t i, size_t j, size_t k)
{
    const NUMBER changed = gradient[entry(i, j) * COORDINATE_COUNT + k];
    const NUMBER half = OF(scaled)(gradient[entry(j, k) * COORDINATE_COUNT + i], R(0.5));
    return OF(difference)(changed, half);
}

#include "model_efforts.h"

/* The efforts at the columns, once the law was computed. */
static void OF(act)(const NUMBER columns[COLUMN_COUNT], WORK *work)
{
    const size_t n = COORDINATE_COUNT;
    const NUMBER *q = columns + INPUT_COUNT;
    const NUMBER *v = q + COORDINATE_COUNT;
    const size_t positions = EFFORT_POSITIONS;
    for (size_t i = 0; i < positions; i++) {
        NUMBER position = work->law[LAW_POSITIONS + i];
        NUMBER rate = OF(constant)(R(0.0));
        for (size_t k = 0; k < n; k++) {
            const Real winding = model_effort_windings[i * n + k];
            const NUMBER slope = work->gradient[(LAW_POSITIONS + i) * n + k];
            position = OF(sum)(position, OF(scaled)(q[k], winding));
            rate = OF(sum)(rate, OF(product)(OF(sum)(slope, OF(constant)(winding)), v[k]));
        }
        work->effort_positions[i] = position;
        work->effort_rates[i] = rate;
    }
    OF(efforts)(columns, columns + FIRST_DRIVEN, work->effort_positions, work->effort_rates, work->efforts,
                work->arguments);
}

/* The accelerations at the columns. */
static void OF(accelerate)(const NUMBER columns[COLUMN_COUNT], WORK *work)
{
    const size_t n = COORDINATE_COUNT;
    const NUMBER *v = columns + INPUT_COUNT + COORDINATE_COUNT;
    const NUMBER *law = work->law;
    const size_t efforts = EFFORT_COUNT;
    const NUMBER *gradient = work->gradient;
    for (size_t i = 0; i < DICTIONARY_COLUMNS; i++) {
        work->columns[i] = i < n ? columns[INPUT_COUNT + i] : columns[i - n];
    }
    OF(dictionary)(&model_law, work->columns, work->law, work->gradient, n, work->atoms, work->slopes);
    OF(add_network)(&model_law_network, work->columns, work->law, work->gradient, n, work->network);
    OF(act)(columns, work);
    for (size_t i = 0; i < n; i++) {
        /* inertia and potential do not act on what is prescribed */
        const size_t inertial = model_prescribed[i] ? 0 : n;
        NUMBER side = law[LAW_FORCE + i];
        if (inertial > 0) {
            side = OF(difference)(side, gradient[LAW_POTENTIAL * COORDINATE_COUNT + i]);
        }
        for (size_t j = 0; j < n; j++) {
            side = OF(difference)(side, OF(product)(law[LAW_DAMPING + i * n + j], v[j]));
            for (size_t k = 0; k < inertial; k++) {
                const NUMBER term = OF(product)(OF(velocity_term)(gradient, i, j, k), v[j]);
                side = OF(difference)(side, OF(product)(term, v[k]));
            }
        }
        for (size_t k = 0; k < efforts; k++) {
            side = OF(sum)(side, OF(product)(law[LAW_EFFORTS + i * EFFORT_COUNT + k], work->efforts[k]));
        }
        work->accelerations[i] = side;
    }
    if (model_forces_network.layer_count > 0) {
        NUMBER *of_velocities = work->force_columns + DICTIONARY_COLUMNS;
        for (size_t i = 0; i < DICTIONARY_COLUMNS; i++) {
            work->force_columns[i] = work->columns[i];
        }
        for (size_t i = 0; i < n; i++) {
            of_velocities[i] = v[i];
        }
        for (size_t u = FIRST_DRIVEN; u < INPUT_COUNT; u++) {
            of_velocities[n + u - FIRST_DRIVEN] = columns[u];
        }
        OF(add_network)(&model_forces_network, work->force_columns, work->accelerations, NULL, 0, work->network);
    }
    for (size_t i = 0; i < n; i++) {
        for (size_t j = 0; j < n; j++) {
            if (model_prescribed[j] && !model_prescribed[i]) {
                const NUMBER force = OF(product)(law[entry(i, j)], work->accelerations[j]);
                work->accelerations[i] = OF(difference)(work->accelerations[i], force);
            }
        }
    }
    OF(factorise)(law, work->factors);
    OF(substitute)(work->factors, work->accelerations);
}

/* v^T M v / 2, once the law was computed. */
static NUMBER OF(kinetic_energy)(const NUMBER v[COORDINATE_COUNT], const NUMBER law[])
{
    NUMBER energy = OF(constant)(R(0.0));
    for (size_t i = 0; i < COORDINATE_COUNT; i++) {
        for (size_t j = 0; j < COORDINATE_COUNT; j++) {
            energy = OF(sum)(energy, OF(product)(OF(product)(v[i], law[entry(i, j)]), v[j]));
        }
    }
    return OF(scaled)(energy, R(0.5));
}

/* A reaction from its functions, with velocities, efforts and accelerations. */
static NUMBER OF(reaction)(const NUMBER functions[REACTION_COUNT], const NUMBER v[COORDINATE_COUNT],
                           const NUMBER efforts[EFFORT_SIZE], const NUMBER a[COORDINATE_COUNT])
{
    NUMBER force = functions[REACTION_REST];
    for (size_t i = 0; i < COORDINATE_COUNT; i++) {
        force = OF(sum)(force, OF(product)(functions[i], a[i]));
        force = OF(sum)(force, OF(product)(functions[REACTION_VELOCITIES + i], v[i]));
        for (size_t j = 0; j <= i; j++) {
            const NUMBER term = OF(product)(functions[REACTION_SQUARES + entry(i, j)], v[i]);
            force = OF(sum)(force, OF(product)(term, v[j]));
        }
    }
    const size_t count = EFFORT_COUNT;
    for (size_t k = 0; k < count; k++) {
        force = OF(sum)(force, OF(product)(functions[REACTION_EFFORTS + k], efforts[k]));
    }
    return force;
}

/* The results at the columns of the working memory. */
static void OF(respond)(WORK *work)
{
    const size_t n = COORDINATE_COUNT;
    const NUMBER *q = work->point + INPUT_COUNT;
    const NUMBER *v = q + COORDINATE_COUNT;
    const NUMBER zero = OF(constant)(R(0.0));
    OF(accelerate)(work->point, work);
    for (size_t i = 0; i < DICTIONARY_COLUMNS; i++) {
        work->along[i] = i < n ? (ALONG){q[i], v[i], work->accelerations[i]} : (ALONG){work->point[i - n], zero, zero};
    }
    OF_ALONG(dictionary)(&model_positions, work->along, work->positions, NULL, 0, work->along_atoms,
                         work->along_slopes);
    OF_ALONG(add_network)(&model_positions_network, work->along, work->positions, NULL, 0, work->along_network);
    for (size_t i = 0; i < model_positions.outputs * COORDINATE_COUNT; i++) {
        if (MATH(fabs)(model_windings[i]) > R(0.0)) {
            ALONG *to = &work->positions[i / n];
            *to = OF_ALONG(sum)(*to, OF_ALONG(scaled)(work->along[i % n], model_windings[i]));
        }
    }
    OF(dictionary)(&model_reactions, work->columns, work->reactions, NULL, 0, work->atoms, work->slopes);
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        const size_t which = model_shown[i].position;
        const ALONG *positions = work->positions;
        switch (model_shown[i].kind) {
        case SHOWN_POSITION:
            work->results[i] = positions[which].value;
            break;
        case SHOWN_VELOCITY:
            work->results[i] = positions[which].first;
            break;
        case SHOWN_ACCELERATION:
            work->results[i] = positions[which].second;
            break;
        case SHOWN_KINETIC_ENERGY:
            work->results[i] = OF(kinetic_energy)(v, work->law);
            break;
        case SHOWN_POTENTIAL_ENERGY:
            work->results[i] = work->law[LAW_POTENTIAL];
            break;
        case SHOWN_REACTION:
            work->results[i] =
                OF(reaction)(&work->reactions[which * REACTION_COUNT], v, work->efforts, work->accelerations);
            break;
        }
    }
    for (size_t i = 0; i < n; i++) {
        work->results[OUTPUT_COUNT + i] = v[i];
        work->results[OUTPUT_COUNT + n + i] = work->accelerations[i];
    }
}
