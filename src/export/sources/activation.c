#include "activation.h"
#include <math.h>
#include <stdint.h>
#include <string.h>

/*
 * Magnitudes below it become zero in hidden values: products of what is left are never denormal, which processors
 * compute at a fraction of the speed.
 */
static const double NEGLIGIBLE = 1e-100;
static const double TANH_ONE = 22.0;      /* from here on tanh rounds to one */
static const double EXP_HALF_MAX = 350.0; /* exp of twice this is still finite */
static const double GELU_LINEAR = 0.7978845608028654;  /* sqrt(2 / pi) */
static const double GELU_CUBIC = 0.03567740813630013; /* 0.044715 sqrt(2 / pi) */

/* 2^k of the integer k in the low bits of 1.5 * 2^52 + k: they become the exponent. */
static inline double two_to_the(double shifted)
{
    uint64_t bits;
    double power;
    memcpy(&bits, &shifted, sizeof bits);
    bits = (bits << 52) + ((uint64_t)1023 << 52);
    memcpy(&power, &bits, sizeof power);
    return power;
}

/*
 * exp(2 x) - 1 for 0 <= x <= EXP_HALF_MAX: 2 x = k ln 2 + r with |r| <= ln(2) / 2, a Taylor polynomial in r, scaled by
 * 2^k. The first omitted term is below 1e-18 of the sum. To be inlined, or the loops around it become no SIMD code.
 */
static inline double exp_minus_one(double x)
{
    const double round = 6755399441055744.0; /* 1.5 * 2^52: a number added to it is rounded to an integer */
    const double shifted = x * (2.0 * 1.4426950408889634) + round;
    const double k = shifted - round;
    const double two_to_k = two_to_the(shifted);
    /* ln 2 in two parts, the first with so few bits that its small multiples are exact */
    const double r = ((x + x) - k * 0.6931471803691238) - k * 1.9082149292705877e-10;
    double sum = 1.0 / 87178291200.0; /* 1 / 14! */
    sum = sum * r + 1.0 / 6227020800.0;
    sum = sum * r + 1.0 / 479001600.0;
    sum = sum * r + 1.0 / 39916800.0;
    sum = sum * r + 1.0 / 3628800.0;
    sum = sum * r + 1.0 / 362880.0;
    sum = sum * r + 1.0 / 40320.0;
    sum = sum * r + 1.0 / 5040.0;
    sum = sum * r + 1.0 / 720.0;
    sum = sum * r + 1.0 / 120.0;
    sum = sum * r + 1.0 / 24.0;
    sum = sum * r + 1.0 / 6.0;
    sum = sum * r + 1.0 / 2.0;
    return two_to_k * (r * r * sum + r) + (two_to_k - 1.0);
}

/*
 * x - k pi for the integer k nearest to x / pi; sign becomes 1, or -1 where k is odd. The sine of x is sign times that of
 * the result.
 */
static inline double reduced(double x, double *sign)
{
    const double round = 6755399441055744.0;
    const double shifted = x * 0.3183098861837907 + round;
    const double k = shifted - round;
    uint64_t bits;
    memcpy(&bits, &shifted, sizeof bits);
    bits = (bits << 63) | ((uint64_t)1023 << 52);
    memcpy(sign, &bits, sizeof bits);
    /* pi in three parts, the first with so few bits that its small multiples are exact */
    return ((x - k * 3.1415926218032837) - k * 3.1786509424591713e-8) - k * 1.2246467864107189e-16;
}

/* The Taylor polynomial for |r| <= pi / 2; the first omitted term is below 2e-18. */
static inline double sine_of_reduced(double r)
{
    const double square = r * r;
    double sum = 1.0 / 51090942171709440000.0; /* 1 / 21! */
    sum = sum * square - 1.0 / 121645100408832000.0;
    sum = sum * square + 1.0 / 355687428096000.0;
    sum = sum * square - 1.0 / 1307674368000.0;
    sum = sum * square + 1.0 / 6227020800.0;
    sum = sum * square - 1.0 / 39916800.0;
    sum = sum * square + 1.0 / 362880.0;
    sum = sum * square - 1.0 / 5040.0;
    sum = sum * square + 1.0 / 120.0;
    sum = sum * square - 1.0 / 6.0;
    return r * square * sum + r;
}

/* The Taylor polynomial for |r| <= pi / 2; the first omitted term is below 2e-17. */
static inline double cosine_of_reduced(double r)
{
    const double square = r * r;
    double sum = 1.0 / 2432902008176640000.0; /* 1 / 20! */
    sum = sum * square - 1.0 / 6402373705728000.0;
    sum = sum * square + 1.0 / 20922789888000.0;
    sum = sum * square - 1.0 / 87178291200.0;
    sum = sum * square + 1.0 / 479001600.0;
    sum = sum * square - 1.0 / 3628800.0;
    sum = sum * square + 1.0 / 40320.0;
    sum = sum * square - 1.0 / 720.0;
    sum = sum * square + 1.0 / 24.0;
    sum = sum * square - 1.0 / 2.0;
    return sum * square + 1.0;
}

/* Magnitudes, limited; in a loop of its own, since compilers make a branch of the limit otherwise. NaN stays NaN. */
static void limit_magnitudes(const double x[BLOCK], double limit, double magnitude[BLOCK])
{
    for (size_t i = 0; i < BLOCK; i++) {
        const double absolute = fabs(x[i]);
        magnitude[i] = absolute > limit ? limit : absolute;
    }
}

/* With e = exp(2 |x|) - 1, tanh |x| = e / (e + 2), which loses nothing near zero. Absolute error below 3e-16. */
static void tanh_block(double x[BLOCK])
{
    double magnitude[BLOCK];
    limit_magnitudes(x, TANH_ONE, magnitude);
    for (size_t i = 0; i < BLOCK; i++) {
        const double e = exp_minus_one(magnitude[i]);
        const double y = copysign(e / (e + 2.0), x[i]);
        x[i] = fabs(y) < NEGLIGIBLE ? 0.0 : y;
    }
}

/* 1 / (1 + exp(-x)) = (1 + tanh(x / 2)) / 2 */
static void sigmoid_block(double x[BLOCK])
{
    for (size_t i = 0; i < BLOCK; i++) {
        x[i] *= 0.5;
    }
    tanh_block(x);
    for (size_t i = 0; i < BLOCK; i++) {
        x[i] = 0.5 * x[i] + 0.5;
    }
}

static void relu_block(double x[BLOCK])
{
    for (size_t i = 0; i < BLOCK; i++) {
        x[i] = x[i] < NEGLIGIBLE ? 0.0 : x[i];
    }
}

/* u of gelu(x) = x (1 + tanh u) / 2 */
static inline double gelu_argument(double x)
{
    return x * (x * x * GELU_CUBIC + GELU_LINEAR);
}

static void gelu_block(double x[BLOCK])
{
    double y[BLOCK];
    for (size_t i = 0; i < BLOCK; i++) {
        y[i] = gelu_argument(x[i]);
    }
    tanh_block(y);
    for (size_t i = 0; i < BLOCK; i++) {
        x[i] = 0.5 * x[i] * y[i] + 0.5 * x[i];
    }
}

/* x / (1 + exp(-x)) */
static void silu_block(double x[BLOCK])
{
    double y[BLOCK];
    memcpy(y, x, sizeof y);
    sigmoid_block(y);
    for (size_t i = 0; i < BLOCK; i++) {
        x[i] *= y[i];
    }
}

/* Absolute error below 3e-16 for |x| up to 8192, beyond which it grows with x. */
static void sine_block(double x[BLOCK])
{
    for (size_t i = 0; i < BLOCK; i++) {
        double sign;
        const double r = reduced(x[i], &sign);
        x[i] = sign * sine_of_reduced(r);
    }
}

/* The slope is 4 (e + 1) / (e + 2)^2: unlike 1 - tanh^2 x it keeps its digits where tanh saturates. */
static void tanh_series(double x[BLOCK], double slope[BLOCK], double curvature[BLOCK])
{
    double magnitude[BLOCK];
    limit_magnitudes(x, EXP_HALF_MAX, magnitude);
    for (size_t i = 0; i < BLOCK; i++) {
        const double e = exp_minus_one(magnitude[i]);
        x[i] = copysign(e / (e + 2.0), x[i]);
        slope[i] = 4.0 * ((e + 1.0) / (e + 2.0)) / (e + 2.0);
        curvature[i] = -2.0 * x[i] * slope[i];
    }
}

static void sigmoid_series(double x[BLOCK], double slope[BLOCK], double curvature[BLOCK])
{
    for (size_t i = 0; i < BLOCK; i++) {
        x[i] *= 0.5;
    }
    tanh_series(x, slope, curvature);
    for (size_t i = 0; i < BLOCK; i++) {
        x[i] = 0.5 * x[i] + 0.5;
        slope[i] *= 0.25;
        curvature[i] *= 0.125;
    }
}

/* The slope is zero at the kink. */
static void relu_series(double x[BLOCK], double slope[BLOCK], double curvature[BLOCK])
{
    for (size_t i = 0; i < BLOCK; i++) {
        slope[i] = x[i] > 0.0 ? 1.0 : 0.0;
        x[i] = x[i] < 0.0 ? 0.0 : x[i];
        curvature[i] = 0.0;
    }
}

/* From the derivatives of tanh u. */
static void gelu_series(double x[BLOCK], double slope[BLOCK], double curvature[BLOCK])
{
    double y[BLOCK];
    for (size_t i = 0; i < BLOCK; i++) {
        y[i] = gelu_argument(x[i]);
    }
    tanh_series(y, slope, curvature);
    for (size_t i = 0; i < BLOCK; i++) {
        const double u1 = 3.0 * x[i] * x[i] * GELU_CUBIC + GELU_LINEAR;
        const double u2 = 6.0 * x[i] * GELU_CUBIC;
        const double inner = 0.5 * x[i];
        const double outer = 0.5 * y[i] + 0.5;
        const double first = slope[i] * u1;
        const double second = curvature[i] * u1 * u1 + slope[i] * u2;
        x[i] *= outer;
        slope[i] = inner * first + outer;
        curvature[i] = inner * second + first;
    }
}

/* From the derivatives of the sigmoid. */
static void silu_series(double x[BLOCK], double slope[BLOCK], double curvature[BLOCK])
{
    double y[BLOCK];
    memcpy(y, x, sizeof y);
    sigmoid_series(y, slope, curvature);
    for (size_t i = 0; i < BLOCK; i++) {
        const double first = slope[i];
        slope[i] = x[i] * first + y[i];
        curvature[i] = x[i] * curvature[i] + 2.0 * first;
        x[i] *= y[i];
    }
}

static void sine_series(double x[BLOCK], double slope[BLOCK], double curvature[BLOCK])
{
    for (size_t i = 0; i < BLOCK; i++) {
        double sign;
        const double r = reduced(x[i], &sign);
        x[i] = sign * sine_of_reduced(r);
        slope[i] = sign * cosine_of_reduced(r);
        curvature[i] = -x[i];
    }
}

static void identity_series(double slope[BLOCK], double curvature[BLOCK])
{
    for (size_t i = 0; i < BLOCK; i++) {
        slope[i] = 1.0;
        curvature[i] = 0.0;
    }
}

void activate(Activation activation, double x[BLOCK])
{
    switch (activation) {
    case ACTIVATION_TANH:
        tanh_block(x);
        break;
    case ACTIVATION_SIGMOID:
        sigmoid_block(x);
        break;
    case ACTIVATION_RELU:
        relu_block(x);
        break;
    case ACTIVATION_GELU:
        gelu_block(x);
        break;
    case ACTIVATION_SILU:
        silu_block(x);
        break;
    case ACTIVATION_SINE:
        sine_block(x);
        break;
    default:
        break; /* the identity */
    }
}

void activate_series(Activation activation, double x[BLOCK], double slope[BLOCK], double curvature[BLOCK])
{
    switch (activation) {
    case ACTIVATION_TANH:
        tanh_series(x, slope, curvature);
        break;
    case ACTIVATION_SIGMOID:
        sigmoid_series(x, slope, curvature);
        break;
    case ACTIVATION_RELU:
        relu_series(x, slope, curvature);
        break;
    case ACTIVATION_GELU:
        gelu_series(x, slope, curvature);
        break;
    case ACTIVATION_SILU:
        silu_series(x, slope, curvature);
        break;
    case ACTIVATION_SINE:
        sine_series(x, slope, curvature);
        break;
    default:
        identity_series(slope, curvature);
        break;
    }
}

void real_activate(Activation activation, double x[], double *slopes, size_t count)
{
    for (size_t block = 0; block < count; block += BLOCK) {
        if (slopes == NULL) {
            activate(activation, x + block);
        } else {
            double curvature[BLOCK];
            activate_series(activation, x + block, slopes + block, curvature);
        }
    }
}
