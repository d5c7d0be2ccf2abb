/*
 * Template without an include guard: runs tapes in one kind of numbers. Define before inclusion: NUMBER, their type;
 * OF(name), the name of a function of them; and CALL(operation, registers), which runs the operations from
 * TAPE_RECIPROCAL on.
 */
#include "blocks.h"

/* Doubles angles, so that few rounding errors add up. */
static void OF(harmonics)(NUMBER angle, size_t count, NUMBER *cosines, NUMBER *sines)
{
    OF(sine_and_cosine)(angle, sines, cosines);
    for (size_t known = 1, i = 1; i < count; i++) {
        known = i == 2 * known ? i : known;
        const NUMBER c = cosines[known - 1];
        const NUMBER s = sines[known - 1];
        const NUMBER other_c = cosines[i - known];
        const NUMBER other_s = sines[i - known];
        cosines[i] = OF(difference)(OF(product)(other_c, c), OF(product)(other_s, s));
        sines[i] = OF(sum)(OF(product)(other_s, c), OF(product)(other_c, s));
    }
}

static void OF(perform)(const Tape *tape, size_t part, NUMBER *registers)
{
    const NUMBER zero = OF(constant)(R(0.0));
    const Operation *const end = tape->operations[part] + tape->counts[part];
    for (const Operation *operation = tape->operations[part]; operation < end; operation++) {
        const NUMBER *a = registers + operation->a;
        const NUMBER *b = registers + operation->b;
        const NUMBER *c = registers + operation->c;
        if (operation->kind == TAPE_PRODUCT) {
            registers[operation->to] = OF(sum)(OF(product)(*a, *b), *c);
            continue;
        }
        const Real *weights = tape->weights + operation->data * (size_t)BLOCK;
        NUMBER *to = registers + operation->to;
        const size_t count = operation->count;
        switch (operation->kind) {
        case TAPE_HARMONICS:
            OF(harmonics)(*a, count, to, to + count);
            break;
        case TAPE_PRODUCTS: {
            NUMBER even = *c;
            NUMBER odd = zero;
            size_t i = 0;
            for (; i + 2 <= count; i += 2) {
                even = OF(sum)(even, OF(product)(a[i], b[i]));
                odd = OF(sum)(odd, OF(product)(a[i + 1], b[i + 1]));
            }
            *to = OF(sum)(i < count ? OF(sum)(even, OF(product)(a[i], b[i])) : even, odd);
            break;
        }
        case TAPE_MATRIX:
            for (size_t block = 0; block < count * BLOCK; block += BLOCK) {
                NUMBER sums[BLOCK];
                for (size_t row = 0; row < BLOCK; row++) {
                    sums[row] = operation->c == tape->inputs ? zero : c[block + row];
                }
                OF(add_block)(weights + block * operation->b, operation->b, a, sums);
                memcpy(to + block, sums, sizeof sums);
            }
            break;
        case TAPE_DOT: {
            NUMBER sums[BLOCK];
            for (size_t row = 0; row < BLOCK; row++) {
                sums[row] = OF(scaled)(a[row], weights[row]);
            }
            for (size_t block = BLOCK; block < count * BLOCK; block += BLOCK) {
                for (size_t row = 0; row < BLOCK; row++) {
                    sums[row] = OF(sum)(sums[row], OF(scaled)(a[block + row], weights[block + row]));
                }
            }
            for (size_t width = BLOCK / 2; width > 0; width /= 2) {
                for (size_t row = 0; row < width; row++) {
                    sums[row] = OF(sum)(sums[row], sums[row + width]);
                }
            }
            *to = OF(sum)(*c, sums[0]);
            break;
        }
        case TAPE_ACTIVATION:
            memcpy(to, a, count * BLOCK * sizeof *to);
            OF(activate)((Activation)operation->function, to, operation->b == 0 ? NULL : to + count * BLOCK,
                         count * BLOCK);
            break;
        case TAPE_BLOCKS:
            for (size_t i = 0; i < count * BLOCK; i++) {
                to[i] = OF(product)(a[i], b[i]);
            }
            break;
        default:
            CALL(operation, registers);
        }
    }
}

/* Runs a tape at inputs x. The registers must be zero before the first run. */
static void OF(run)(const Tape *tape, const NUMBER *x, NUMBER *registers)
{
    const bool is_first = OF(value)(registers[tape->inputs + 1]) < R(1.0);
    const size_t fixed = tape->first_fixed;
    const bool changes = is_first || memcmp(registers + fixed, x + fixed, tape->fixed_count * sizeof *x) != 0;
    if (!changes && memcmp(registers, x, tape->inputs * sizeof *x) == 0) {
        /* same inputs: those of outputs at the end of a step, where the next step begins */
        return;
    }
    memcpy(registers, x, tape->inputs * sizeof *x);
    for (size_t i = 0; is_first && i < tape->constant_count; i++) {
        registers[tape->constants[i].of] = OF(constant)(tape->constants[i].value);
    }
    if (changes) {
        OF(perform)(tape, 0, registers);
    }
    OF(perform)(tape, 1, registers);
}
