#include "activation.h"
#include "clones.h"
#include <stdint.h>
#include <string.h>

/*
 * NEGLIGIBLE: hidden values of a smaller magnitude become zero. Products of the other values are then never denormal,
 * which processors compute at a fraction of the speed.
 *
 * TANH_ONE: from here on, tanh rounds to one.
 *
 * EXP_HALF_MAX: exp of twice this number is still finite.
 *
 * ROUND: 1.5 times the power of two of the last of FRACTION bits. Adding it to a number rounds the number to an
 * integer.
 */
#ifdef METAFMU_SINGLE
typedef uint32_t Bits;
enum { FRACTION = 23, BIAS = 127 };
static const Real ROUND = 12582912.0f;
static const Real NEGLIGIBLE = 1e-18f;
static const Real TANH_ONE = 10.0f;
static const Real EXP_HALF_MAX = 43.0f;
#else
typedef uint64_t Bits;
enum { FRACTION = 52, BIAS = 1023 };
static const Real ROUND = 6755399441055744.0;
static const Real NEGLIGIBLE = 1e-100;
static const Real TANH_ONE = 22.0;
static const Real EXP_HALF_MAX = 350.0;
#endif

/* Returns 2^k for the integer k in the low bits of ROUND + k, which become the exponent. */
static INLINED Real two_to_the(Real shifted)
{
    Bits bits;
    Real power;
    memcpy(&bits, &shifted, sizeof bits);
    bits = (bits << FRACTION) + ((Bits)BIAS << FRACTION);
    memcpy(&power, &bits, sizeof power);
    return power;
}

/*
 * Returns exp(2 x) - 1 for 0 <= x <= EXP_HALF_MAX. With 2 x = k ln 2 + r and |r| <= ln(2) / 2, a Taylor polynomial in r
 * is scaled by 2^k. The first omitted term is below 1e-18 of the sum, in single precision below 1e-9. Must be inlined:
 * otherwise compilers do not vectorize the loops around it.
 */
static INLINED Real exp_minus_one(Real x)
{
    const Real shifted = x * (R(2.0) * R(1.4426950408889634)) + ROUND;
    const Real k = shifted - ROUND;
    const Real two_to_k = two_to_the(shifted);
    /* ln 2 in two parts; the first has so few bits that its small multiples are exact */
#ifdef METAFMU_SINGLE
    const Real r = ((x + x) - k * 0.693359375f) + k * 2.12194440e-4f;
    Real sum = 1.0f / 40320.0f; /* 1 / 8! */
#else
    const Real r = ((x + x) - k * 0.6931471803691238) - k * 1.9082149292705877e-10;
    Real sum = 1.0 / 87178291200.0; /* 1 / 14! */
    sum = sum * r + 1.0 / 6227020800.0;
    sum = sum * r + 1.0 / 479001600.0;
    sum = sum * r + 1.0 / 39916800.0;
    sum = sum * r + 1.0 / 3628800.0;
    sum = sum * r + 1.0 / 362880.0;
    sum = sum * r + 1.0 / 40320.0;
#endif
    sum = sum * r + R(1.0) / R(5040.0);
    sum = sum * r + R(1.0) / R(720.0);
    sum = sum * r + R(1.0) / R(120.0);
    sum = sum * r + R(1.0) / R(24.0);
    sum = sum * r + R(1.0) / R(6.0);
    sum = sum * r + R(1.0) / R(2.0);
    return two_to_k * (r * r * sum + r) + (two_to_k - R(1.0));
}

/*
 * Returns x - k pi for the integer k nearest to x / pi. Sets sign to 1, or to -1 if k is odd: the sine of x is sign
 * times the sine of the result.
 */
static INLINED Real reduced(Real x, Real *sign)
{
    const Real shifted = x * R(0.3183098861837907) + ROUND;
    const Real k = shifted - ROUND;
    Bits bits;
    memcpy(&bits, &shifted, sizeof bits);
    bits = (bits << (sizeof bits * 8 - 1)) | ((Bits)BIAS << FRACTION);
    memcpy(sign, &bits, sizeof bits);
    /* pi in three parts; the first has so few bits that its small multiples are exact */
#ifdef METAFMU_SINGLE
    return ((x - k * 3.140625f) - k * 9.67502593994140625e-4f) - k * 1.509957990978376432e-7f;
#else
    return ((x - k * 3.1415926218032837) - k * 3.1786509424591713e-8) - k * 1.2246467864107189e-16;
#endif
}

/* Returns the Taylor polynomial for |r| <= pi / 2. The first omitted term is below 2e-18, in single precision below 1e-9. */
static INLINED Real sine_of_reduced(Real r)
{
    const Real square = r * r;
#ifdef METAFMU_SINGLE
    Real sum = 1.0f / 6227020800.0f; /* 1 / 13! */
#else
    Real sum = 1.0 / 51090942171709440000.0; /* 1 / 21! */
    sum = sum * square - 1.0 / 121645100408832000.0;
    sum = sum * square + 1.0 / 355687428096000.0;
    sum = sum * square - 1.0 / 1307674368000.0;
    sum = sum * square + 1.0 / 6227020800.0;
#endif
    sum = sum * square - R(1.0) / R(39916800.0);
    sum = sum * square + R(1.0) / R(362880.0);
    sum = sum * square - R(1.0) / R(5040.0);
    sum = sum * square + R(1.0) / R(120.0);
    sum = sum * square - R(1.0) / R(6.0);
    return r * square * sum + r;
}

/* Returns the Taylor polynomial for |r| <= pi / 2. The first omitted term is below 2e-17, in single precision below 7e-9. */
static INLINED Real cosine_of_reduced(Real r)
{
    const Real square = r * r;
#ifdef METAFMU_SINGLE
    Real sum = 1.0f / 479001600.0f; /* 1 / 12! */
#else
    Real sum = 1.0 / 2432902008176640000.0; /* 1 / 20! */
    sum = sum * square - 1.0 / 6402373705728000.0;
    sum = sum * square + 1.0 / 20922789888000.0;
    sum = sum * square - 1.0 / 87178291200.0;
    sum = sum * square + 1.0 / 479001600.0;
#endif
    sum = sum * square - R(1.0) / R(3628800.0);
    sum = sum * square + R(1.0) / R(40320.0);
    sum = sum * square - R(1.0) / R(720.0);
    sum = sum * square + R(1.0) / R(24.0);
    sum = sum * square - R(1.0) / R(2.0);
    return sum * square + R(1.0);
}

/* Computes magnitudes up to a limit. The loop is separate, since compilers otherwise turn the limit into a branch. NaN stays NaN. */
static INLINED void limit_magnitudes(const Real x[BLOCK], Real limit, Real magnitude[BLOCK])
{
    for (size_t i = 0; i < BLOCK; i++) {
        const Real absolute = MATH(fabs)(x[i]);
        magnitude[i] = absolute > limit ? limit : absolute;
    }
}

/* ---- Blocks: numbers for activation_formulas.h whose operations are loops of a constant length ---- */

typedef struct {
    Real of[BLOCK];
} Block;

static INLINED Block block_constant(Real value)
{
    Block a;
    for (size_t i = 0; i < BLOCK; i++) {
        a.of[i] = value;
    }
    return a;
}

static INLINED Block block_sum(Block a, Block b)
{
    for (size_t i = 0; i < BLOCK; i++) {
        a.of[i] += b.of[i];
    }
    return a;
}

static INLINED Block block_difference(Block a, Block b)
{
    for (size_t i = 0; i < BLOCK; i++) {
        a.of[i] -= b.of[i];
    }
    return a;
}

static INLINED Block block_product(Block a, Block b)
{
    for (size_t i = 0; i < BLOCK; i++) {
        a.of[i] *= b.of[i];
    }
    return a;
}

static INLINED Block block_scaled(Block a, Real by)
{
    for (size_t i = 0; i < BLOCK; i++) {
        a.of[i] *= by;
    }
    return a;
}

/* With e = exp(2 |x|) - 1, tanh |x| = e / (e + 2) keeps its digits near zero. Absolute error below 3e-16, in single precision 2e-7. */
static INLINED Block block_hyperbolic_tangent(Block a)
{
    Block magnitude;
    limit_magnitudes(a.of, TANH_ONE, magnitude.of);
    for (size_t i = 0; i < BLOCK; i++) {
        const Real e = exp_minus_one(magnitude.of[i]);
        const Real y = MATH(copysign)(e / (e + R(2.0)), a.of[i]);
        a.of[i] = MATH(fabs)(y) < NEGLIGIBLE ? R(0.0) : y;
    }
    return a;
}

/* Absolute error below 3e-16, in single precision 2e-7, for |x| up to 8192; beyond, it grows with x. */
static INLINED void block_sine_and_cosine(Block a, Block *sine, Block *cosine)
{
    for (size_t i = 0; i < BLOCK; i++) {
        Real sign;
        const Real r = reduced(a.of[i], &sign);
        sine->of[i] = sign * sine_of_reduced(r);
        cosine->of[i] = sign * cosine_of_reduced(r);
    }
}

static INLINED Block block_positive_part(Block a, Block *slope)
{
    for (size_t i = 0; i < BLOCK; i++) {
        slope->of[i] = a.of[i] > R(0.0) ? R(1.0) : R(0.0);
        a.of[i] = a.of[i] < NEGLIGIBLE ? R(0.0) : a.of[i];
    }
    return a;
}

#define NUMBER Block
#define OF(name) block_##name
#include "activation_formulas.h"
#undef NUMBER
#undef OF

/* ---- Blocks with their first and second derivatives ---- */

typedef struct {
    Block value;
    Block first;
    Block second;
} BlockSeries;

#define NUMBER BlockSeries
#define OF(name) series_##name
#define PART Block
#define OF_PART(name) block_##name
#include "jet_arithmetic.h"
#undef PART
#undef OF_PART

/* The slope is 4 (e + 1) / (e + 2)^2: unlike 1 - tanh^2 x, it keeps its digits where tanh saturates. */
static INLINED BlockSeries series_hyperbolic_tangent(BlockSeries a)
{
    Block magnitude;
    limit_magnitudes(a.value.of, EXP_HALF_MAX, magnitude.of);
    for (size_t i = 0; i < BLOCK; i++) {
        const Real e = exp_minus_one(magnitude.of[i]);
        const Real y = MATH(copysign)(e / (e + R(2.0)), a.value.of[i]);
        const Real slope = R(4.0) * ((e + R(1.0)) / (e + R(2.0))) / (e + R(2.0));
        a.second.of[i] = slope * (a.second.of[i] - R(2.0) * (y * a.first.of[i] * a.first.of[i]));
        a.first.of[i] *= slope;
        a.value.of[i] = y;
    }
    return a;
}

static INLINED void series_sine_and_cosine(BlockSeries a, BlockSeries *sine, BlockSeries *cosine)
{
    Block s;
    Block c;
    block_sine_and_cosine(a.value, &s, &c);
    for (size_t i = 0; i < BLOCK; i++) {
        const Real square = a.first.of[i] * a.first.of[i];
        sine->second.of[i] = c.of[i] * a.second.of[i] - s.of[i] * square;
        cosine->second.of[i] = -s.of[i] * a.second.of[i] - c.of[i] * square;
        sine->first.of[i] = c.of[i] * a.first.of[i];
        cosine->first.of[i] = -s.of[i] * a.first.of[i];
    }
    sine->value = s;
    cosine->value = c;
}

/* The slope is zero at the kink. */
static INLINED BlockSeries series_positive_part(BlockSeries a, BlockSeries *slope)
{
    *slope = series_constant(R(0.0));
    a.value = block_positive_part(a.value, &slope->value);
    a.first = block_product(a.first, slope->value);
    a.second = block_product(a.second, slope->value);
    return a;
}

#include "activation_formulas.h"

CLONED void activate(Activation activation, Real x[BLOCK])
{
    Block slope;
    block_activate_one(activation, (Block *)x, &slope);
}

CLONED void activate_series(Activation activation, Real x[BLOCK], Real slope[BLOCK], Real curvature[BLOCK])
{
    BlockSeries value;
    BlockSeries slopes;
    for (size_t i = 0; i < BLOCK; i++) {
        value.value.of[i] = x[i];
        value.first.of[i] = R(1.0);
        value.second.of[i] = R(0.0);
    }
    series_activate_one(activation, &value, &slopes);
    for (size_t i = 0; i < BLOCK; i++) {
        x[i] = value.value.of[i];
        slope[i] = value.first.of[i];
        curvature[i] = value.second.of[i];
    }
}

CLONED void real_activate(Activation activation, Real x[], Real *slopes, size_t count)
{
    for (size_t block = 0; block < count; block += BLOCK) {
        if (slopes == NULL) {
            activate(activation, x + block);
        } else {
            Real curvature[BLOCK];
            activate_series(activation, x + block, slopes + block, curvature);
        }
    }
}
