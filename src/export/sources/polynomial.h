/*
 * A template: a polynomial in one kind of numbers. Before it is included, NUMBER is their type and OF(name) the name of
 * a function of them; without them it has the declarations.
 *
 * y_o is the sum over the terms t of coefficients[o, t] times the product of P_degrees[t, i](z_i), with Legendre
 * polynomials P_k. In multiplications, additions and divisions it takes at worst
 *
 *     9 (d - 1)    for a column, with d > 0 the highest degree,
 *     f + 2 m      for a term of f factors, with m outputs.
 */

#ifndef NUMBER

extern const unsigned char model_degrees[TERM_COUNT * MAP_COLUMNS]; /* of each term in each column */
extern const Real model_coefficients[OUTPUT_COUNT * TERM_COUNT];

#else /* the template */

/* P_0(z), P_1(z), ...: (k + 1) P_(k + 1) = (2 k + 1) z P_k - k P_(k - 1). */
static void OF(legendre)(NUMBER z, NUMBER values[ORDER_COUNT])
{
    values[0] = OF(constant)(R(1.0));
    values[1] = z;
    for (size_t k = 1; k + 1 < ORDER_COUNT; k++) {
        const Real order = (Real)k;
        const Real next = order + R(1.0);
        const NUMBER by_z = OF(product)(OF(scaled)(z, (R(2.0) * order + R(1.0)) / next), values[k]);
        values[k + 1] = OF(difference)(by_z, OF(scaled)(values[k - 1], order / next));
    }
}

static void OF(function)(const NUMBER z[MAP_COLUMNS], NUMBER y[OUTPUT_COUNT], NUMBER table[TABLE_SIZE])
{
    for (size_t i = 0; i < MAP_COLUMNS; i++) {
        OF(legendre)(z[i], table + i * ORDER_COUNT);
    }
    for (size_t i = 0; i < OUTPUT_COUNT; i++) {
        y[i] = OF(constant)(R(0.0));
    }
    for (size_t term = 0; term < TERM_COUNT; term++) {
        NUMBER value = OF(constant)(R(1.0));
        for (size_t i = 0; i < MAP_COLUMNS; i++) {
            const size_t degree = model_degrees[term * MAP_COLUMNS + i];
            if (degree > 0) {
                value = OF(product)(value, table[i * ORDER_COUNT + degree]);
            }
        }
        for (size_t i = 0; i < OUTPUT_COUNT; i++) {
            y[i] = OF(sum)(y[i], OF(scaled)(value, model_coefficients[i * TERM_COUNT + term]));
        }
    }
}

#endif
