/*
 * Template without an include guard: arithmetic of numbers with their first and second derivatives. Define before
 * inclusion: NUMBER, their type; OF(name), the name of a function of them; PART, the type of a value and a derivative;
 * and OF_PART(name), the name of a function of these.
 */

static INLINED NUMBER OF(constant)(Real value)
{
    return (NUMBER){OF_PART(constant)(value), OF_PART(constant)(R(0.0)), OF_PART(constant)(R(0.0))};
}

static INLINED NUMBER OF(sum)(NUMBER a, NUMBER b)
{
    return (NUMBER){OF_PART(sum)(a.value, b.value), OF_PART(sum)(a.first, b.first), OF_PART(sum)(a.second, b.second)};
}

static INLINED NUMBER OF(difference)(NUMBER a, NUMBER b)
{
    return (NUMBER){OF_PART(difference)(a.value, b.value), OF_PART(difference)(a.first, b.first),
                    OF_PART(difference)(a.second, b.second)};
}

static INLINED NUMBER OF(product)(NUMBER a, NUMBER b)
{
    const PART first = OF_PART(sum)(OF_PART(product)(a.first, b.value), OF_PART(product)(a.value, b.first));
    const PART mixed = OF_PART(scaled)(OF_PART(product)(a.first, b.first), R(2.0));
    const PART bent = OF_PART(sum)(OF_PART(product)(a.second, b.value), mixed);
    const PART second = OF_PART(sum)(bent, OF_PART(product)(a.value, b.second));
    return (NUMBER){OF_PART(product)(a.value, b.value), first, second};
}

static INLINED NUMBER OF(scaled)(NUMBER a, Real by)
{
    return (NUMBER){OF_PART(scaled)(a.value, by), OF_PART(scaled)(a.first, by), OF_PART(scaled)(a.second, by)};
}
