/*
 * Stages of the method Rodas5P: a Rosenbrock method of order 5, L-stable and stiffly accurate, with an embedded method
 * of order 4. With W = 1 / (gamma h) - J and
 *
 *     W U_i = f(t + c_i h, y + sum a_ij U_j) + sum C_ij / h U_j + h d_i f_t
 *
 * a step ends at the last argument of f plus U_8, and its error is about U_8. The Jacobian J and f_t are differences.
 * Part of states.c.
 *
 * Source: Steinebach, Construction of Rosenbrock-Wanner method Rodas5P and numerical benchmarks within the Julia
 * Differential Equations package, BIT 63, 2023.
 */
#ifndef ROSENBROCK_H
#define ROSENBROCK_H

static const Real GAMMA = R(0.21193756319429014);

/* c */
static const Real STAGE_TIMES[IMPLICIT_STAGES] = {
    R(0.0), R(0.6358126895828704), R(0.4095798393397535), R(0.9769306725060716), R(0.4288403609558664),
    R(1.0), R(1.0), R(1.0),
};

/* d */
static const Real BY_TIME[IMPLICIT_STAGES] = {
    R(0.21193756319429014), -R(0.42387512638858027), -R(0.3384627126235924), R(1.8046452872882734),
    R(2.325825639765069), R(0.0), R(0.0), R(0.0),
};

/* a */
static const Real STAGE_WEIGHTS[IMPLICIT_STAGES][IMPLICIT_STAGES - 1] = {
    {R(0.0)},
    {R(3.0)},
    {R(2.849394379747939), R(0.45842242204463923)},
    {-R(6.954028509809101), R(2.489845061869568), -R(10.358996098473584)},
    {R(2.8029986275628964), R(0.5072464736228206), -R(0.3988312541770524), -R(0.04721187230404641)},
    {-R(7.502846399306121), R(2.561846144803919), -R(11.627539656261098), -R(0.18268767659942256),
     R(0.030198172008377946)},
    {-R(7.502846399306121), R(2.561846144803919), -R(11.627539656261098), -R(0.18268767659942256),
     R(0.030198172008377946), R(1.0)},
    {-R(7.502846399306121), R(2.561846144803919), -R(11.627539656261098), -R(0.18268767659942256),
     R(0.030198172008377946), R(1.0), R(1.0)},
};

/* C */
static const Real COUPLINGS[IMPLICIT_STAGES][IMPLICIT_STAGES - 1] = {
    {R(0.0)},
    {-R(14.155112264123755)},
    {-R(17.97296035885952), -R(2.859693295451294)},
    {R(147.12150275711716), -R(1.41221402718213), R(71.68940251302358)},
    {R(165.43517024871676), -R(0.4592823456491126), R(42.90938336958603), -R(5.961986721573306)},
    {R(24.854864614690072), -R(3.0009227002832186), R(47.4931110020768), R(5.5814197821558125),
     -R(0.6610691825249471)},
    {R(30.91273214028599), -R(3.1208243349937974), R(77.79954646070892), R(34.28646028294783),
     -R(19.097331116725623), -R(28.087943162872662)},
    {R(37.80277123390563), -R(3.2571969029072276), R(112.26918849496327), R(66.9347231244047),
     -R(40.06618937091002), -R(54.66780262877968), -R(9.48861652309627)},
};

/* Part of a step in the difference that approximates the derivative with respect to time. */
#ifdef METAFMU_SINGLE
#define SHORT_PART R(1e-2)
#else
#define SHORT_PART 1e-6
#endif

/* Computes the rates at the stage, with the inputs at time `later`. Arguments with bends go to arguments[part]. */
static void respond_at(Scratch *scratch, Real later, size_t part)
{
    for (size_t i = FIRST_DRIVEN; i < INPUT_COUNT; i++) {
        scratch->solver.stage[i] = driven(&scratch->solver.drives[i], later);
    }
    model_rates(scratch, scratch->solver.stage, scratch->solver.implicit.rates, scratch->solver.arguments[part]);
}

/* Computes the Jacobian at the beginning of a step and, if inputs change, the derivative with respect to time. */
static void find_jacobian(Scratch *scratch, Real since, Real h)
{
    Rosenbrock *work = &scratch->solver.implicit;
    const Real *before = scratch->solver.rates[0];
    bool is_driven = false;
    begin(scratch);
    for (size_t column = 0; column < STATE_COUNT; column++) {
        Real *state = &scratch->solver.stage[INPUT_COUNT + column];
        const Real value = *state;
        const Real nominal = (Real)model_scales[column].nominal;
        const Real magnitude = MATH(fabs)(value);
        *state = value + MATH(sqrt)(REAL_EPSILON) * (nominal > magnitude ? nominal : magnitude);
        const Real by = *state - value;
        respond_at(scratch, since, SOLVER_STAGES - 1);
        *state = value;
        for (size_t i = 0; i < STATE_COUNT; i++) {
            work->jacobian[i][column] = (work->rates[i] - before[i]) / by;
        }
    }
    for (size_t i = FIRST_DRIVEN; i < INPUT_COUNT; i++) {
        const Drive *drive = &scratch->solver.drives[i];
        is_driven = is_driven || drive->rate < R(0.0) || drive->rate > R(0.0) || drive->second_rate < R(0.0)
            || drive->second_rate > R(0.0);
    }
    if (is_driven) {
        const Real by = SHORT_PART * h;
        respond_at(scratch, since + by, SOLVER_STAGES - 1);
        for (size_t i = 0; i < STATE_COUNT; i++) {
            work->by_time[i] = (work->rates[i] - before[i]) / by;
        }
    } else {
        for (size_t i = 0; i < STATE_COUNT; i++) {
            work->by_time[i] = R(0.0);
        }
    }
}

/* Factorizes 1 / (gamma h) - J with partial pivoting. A singular matrix gives NaN. */
static void factorise(Rosenbrock *work, Real h)
{
    for (size_t i = 0; i < STATE_COUNT; i++) {
        for (size_t j = 0; j < STATE_COUNT; j++) {
            work->factors[i][j] = i == j ? R(1.0) / (GAMMA * h) - work->jacobian[i][j] : -work->jacobian[i][j];
        }
    }
    for (size_t k = 0; k < STATE_COUNT; k++) {
        size_t pivot = k;
        for (size_t i = k + 1; i < STATE_COUNT; i++) {
            if (MATH(fabs)(work->factors[i][k]) > MATH(fabs)(work->factors[pivot][k])) {
                pivot = i;
            }
        }
        work->pivots[k] = pivot;
        for (size_t j = 0; j < STATE_COUNT; j++) {
            const Real moved = work->factors[k][j];
            work->factors[k][j] = work->factors[pivot][j];
            work->factors[pivot][j] = moved;
        }
        for (size_t i = k + 1; i < STATE_COUNT; i++) {
            work->factors[i][k] /= work->factors[k][k];
            for (size_t j = k + 1; j < STATE_COUNT; j++) {
                work->factors[i][j] -= work->factors[i][k] * work->factors[k][j];
            }
        }
    }
}

/* Solves W U = rates for a stage. */
static void solve_stage(Rosenbrock *work, size_t stage)
{
    Real *side = work->changes[stage];
    memcpy(side, work->rates, sizeof work->rates);
    for (size_t k = 0; k < STATE_COUNT; k++) {
        const Real moved = side[k];
        side[k] = side[work->pivots[k]];
        side[work->pivots[k]] = moved;
    }
    for (size_t k = 0; k < STATE_COUNT; k++) {
        for (size_t j = 0; j < k; j++) {
            side[k] -= work->factors[k][j] * side[j];
        }
    }
    for (size_t k = STATE_COUNT; k-- > 0;) {
        for (size_t j = STATE_COUNT; j-- > k + 1;) {
            side[k] -= work->factors[k][j] * side[j];
        }
        side[k] /= work->factors[k][k];
    }
}

/* Makes a step of size h, `since` seconds after the beginning. Its first rates are known. */
static void implicit_stages(Scratch *scratch, Real since, Real h, bool is_repeated)
{
    Rosenbrock *work = &scratch->solver.implicit;
    if (!is_repeated) {
        find_jacobian(scratch, since, h);
    }
    factorise(work, h);
    for (size_t stage = 0; stage < IMPLICIT_STAGES; stage++) {
        begin(scratch);
        for (size_t j = 0; j < stage; j++) {
            for (size_t i = 0; i < STATE_COUNT; i++) {
                scratch->solver.stage[INPUT_COUNT + i] += STAGE_WEIGHTS[stage][j] * work->changes[j][i];
            }
        }
        if (stage == 0) {
            memcpy(work->rates, scratch->solver.rates[0], sizeof work->rates);
        } else {
            respond_at(scratch, since + STAGE_TIMES[stage] * h, stage < SOLVER_STAGES ? stage : SOLVER_STAGES - 1);
        }
        for (size_t j = 0; j < stage; j++) {
            for (size_t i = 0; i < STATE_COUNT; i++) {
                work->rates[i] += COUPLINGS[stage][j] / h * work->changes[j][i];
            }
        }
        for (size_t i = 0; i < STATE_COUNT; i++) {
            work->rates[i] += h * BY_TIME[stage] * work->by_time[i];
        }
        solve_stage(work, stage);
    }
}

/* Moves to the end of the step. */
static void add_implicit_changes(Scratch *scratch)
{
    const Rosenbrock *work = &scratch->solver.implicit;
    for (size_t i = 0; i < STATE_COUNT; i++) {
        Real change = R(0.0);
        for (size_t j = 0; j < IMPLICIT_STAGES - 1; j++) {
            change += STAGE_WEIGHTS[IMPLICIT_STAGES - 1][j] * work->changes[j][i];
        }
        add_to_state(scratch, i, change + work->changes[IMPLICIT_STAGES - 1][i]);
    }
}

#endif
