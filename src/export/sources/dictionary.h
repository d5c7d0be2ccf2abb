/*
 * A template, without a guard: a dictionary evaluated in one kind of numbers. Before it is included, NUMBER is their
 * type and OF(name) the name of a function of them.
 */

/* The functions of a column: of an angle cos and sin of 1, cos and sin of 2, ...; else the powers 1, 2, ... */
static void OF(atoms)(const DictionaryColumn *column, NUMBER x, NUMBER values[], NUMBER slopes[])
{
    NUMBER sine;
    NUMBER cosine;
    if (column->orders == 0) {
        return;
    }
    if (!column->angle) {
        const NUMBER z = OF(scaled)(OF(difference)(x, OF(constant)(column->middle)), column->scale);
        NUMBER power = OF(constant)(R(1.0));
        for (size_t i = 0; i < column->orders; i++) {
            slopes[i] = OF(scaled)(power, (Real)(i + 1) * column->scale);
            power = OF(product)(power, z);
            values[i] = power;
        }
        return;
    }
    OF(sine_and_cosine)(x, &sine, &cosine);
    /* of the multiple before */
    NUMBER s = OF(constant)(R(0.0));
    NUMBER c = OF(constant)(R(1.0));
    for (size_t i = 0; i < column->orders; i++) {
        const Real k = (Real)(i + 1);
        const NUMBER next = OF(sum)(OF(product)(s, cosine), OF(product)(c, sine));
        c = OF(difference)(OF(product)(c, cosine), OF(product)(s, sine));
        s = next;
        values[2 * i] = c;
        slopes[2 * i] = OF(scaled)(s, -k);
        values[2 * i + 1] = s;
        slopes[2 * i + 1] = OF(scaled)(c, k);
    }
}

/* y at x, and y's derivatives with respect to the first columns, so many: gradient[output * first + column]. */
static void OF(dictionary)(const Dictionary *dictionary, const NUMBER *x, NUMBER *y, NUMBER *gradient, size_t first,
                           NUMBER *values, NUMBER *slopes)
{
    const Factor *factors = dictionary->factors;
    const Coefficient *coefficients = dictionary->coefficients;
    size_t atom = 0;
    for (size_t i = 0; i < DICTIONARY_COLUMNS; i++) {
        const DictionaryColumn *column = &dictionary->columns[i];
        OF(atoms)(column, x[i], values + atom, slopes + atom);
        atom += column->angle ? 2 * column->orders : column->orders;
    }
    for (size_t i = 0; i < dictionary->outputs; i++) {
        y[i] = OF(constant)(R(0.0));
        for (size_t k = 0; k < first; k++) {
            gradient[i * first + k] = OF(constant)(R(0.0));
        }
    }
    for (size_t p = 0; p < dictionary->product_count; p++) {
        const Product product = dictionary->products[p];
        NUMBER value = OF(constant)(R(1.0));
        for (size_t f = 0; f < product.factors; f++) {
            value = OF(product)(value, values[factors[f].atom]);
        }
        for (size_t c = 0; c < product.coefficients; c++) {
            NUMBER *to = &y[coefficients[c].output];
            *to = OF(sum)(*to, OF(scaled)(value, coefficients[c].value));
        }
        for (size_t f = 0; first > 0 && f < product.factors; f++) {
            if (factors[f].column >= first) {
                continue;
            }
            NUMBER slope = slopes[factors[f].atom];
            for (size_t other = 0; other < product.factors; other++) {
                if (other != f) {
                    slope = OF(product)(slope, values[factors[other].atom]);
                }
            }
            for (size_t c = 0; c < product.coefficients; c++) {
                NUMBER *to = &gradient[coefficients[c].output * first + factors[f].column];
                *to = OF(sum)(*to, OF(scaled)(slope, coefficients[c].value));
            }
        }
        factors += product.factors;
        coefficients += product.coefficients;
    }
}
