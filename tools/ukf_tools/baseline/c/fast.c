/* The filter as fast as we can write it, in binary32: square root by Gram-Schmidt, as the core does.
 *
 * Compiled once with all noise augmented (22 sigma points) and once with -DADDITIVE (9). W0 is 0:
 * sigma point 0 has no weight, so it is not even made. What is used of the structure:
 *
 * - Sigma points of w and v are constants, and only the first columns of those of x differ from x.
 * - The sigma coefficients of a row are two numbers, so points are running sums, not a product.
 * - One Gram-Schmidt over rows of residuals, observations first, gives gain, state and next factor.
 * - Additive noise stands in columns beside the points, which are zero before they are touched.
 *
 * Points lie along the vectors, so 4 of them go through models and elimination at once. With -DTRACED
 * the models are those that are written from the functions in Python, which take one at a time.
 */
#include "baseline.h"

#include <math.h>

#ifdef TRACED
#ifdef ADDITIVE
#include "traced_additive.h"
#define MODEL_F traced_additive_f
#define MODEL_H traced_additive_h
#else
#include "traced.h"
#define MODEL_F traced_f
#define MODEL_H traced_h
#endif
#endif

typedef float vector __attribute__((vector_size(16)));
enum { LANES = 4 };

#ifdef ADDITIVE
enum { M = STATES };
#else
enum { M = 2 * STATES + OBSERVATIONS };
#endif
enum {
    POINTS = M + 1,                            /* without point 0 */
    WORDS = (POINTS + LANES - 1) / LANES,      /* vectors of points */
    DRAWN = (STATES + 1 + LANES - 1) / LANES,  /* vectors whose points differ from x */
    ROWS = OBSERVATIONS + STATES,
};
#ifdef ADDITIVE
/* Columns of a row: noise of z, in reverse | points | noise of x; each in whole vectors. */
enum { LEFT = 2, RIGHT = 2, COLUMNS = LEFT + WORDS + RIGHT };
#else
enum { LEFT = 0, RIGHT = 0, COLUMNS = WORDS };
#endif

union row {
    vector words[COLUMNS];
    float numbers[COLUMNS * LANES];
};
union points {
    vector words[WORDS];
    float numbers[WORDS * LANES];
};

static float dt, root_weight;
static float x[STATES], L[STATES][STATES], coefficient[STATES];
static union points X[STATES], Z[OBSERVATIONS], used;
static union row E[ROWS];
static float right[ROWS];
#ifdef ADDITIVE
static float LQ[STATES][STATES], LR[OBSERVATIONS][OBSERVATIONS];
#else
static union points W[STATES], V[OBSERVATIONS];
#endif

static int factor(int size, const double *A, double *B)
{
    for (int j = 0; j < size; j++)
        for (int i = 0; i < size; i++) {
            double sum = A[i * size + j];
            for (int k = 0; k < j; k++)
                sum -= B[i * size + k] * B[j * size + k];
            if (i == j && !(sum > 0.0))
                return 1;
            B[i * size + j] = i < j ? 0.0 : i == j ? sqrt(sum) : sum / B[j * size + j];
        }
    return 0;
}

static double simplex(int j) { return 1.0 / sqrt(j * (j + 1) * (1.0 / (M + 1))); }

#ifndef ADDITIVE
/* Sigma points of a noise whose first term is number `first` of the augmented state. */
static void draw_noise(int size, const double *B, int first, union points *rows)
{
    for (int i = 0; i < size; i++)
        for (int k = 1; k <= POINTS; k++) {
            double sum = 0.0;
            for (int t = 0; t <= i; t++) {
                const int j = first + t + 1;
                const double s = k <= j ? -simplex(j) : k == j + 1 ? j * simplex(j) : 0.0;
                sum += B[i * size + t] * s;
            }
            rows[i].numbers[k - 1] = (float)sum;
        }
}
#endif

static void initialise(double interval, const double *x0, const double *P0, const double *Q,
                       const double *R)
{
    double B[STATES * STATES];
    dt = (float)interval;
    root_weight = (float)sqrt(1.0 / (M + 1));
    factor(STATES, P0, B);
    for (int i = 0; i < STATES; i++) {
        x[i] = (float)x0[i];
        coefficient[i] = (float)simplex(i + 1);
        for (int j = 0; j < STATES; j++)
            L[i][j] = (float)B[i * STATES + j];
    }
    for (int k = 0; k < WORDS * LANES; k++)
        used.numbers[k] = k < POINTS ? root_weight : 0.0f;
    factor(STATES, Q, B);
#ifdef ADDITIVE
    for (int i = 0; i < STATES; i++)
        for (int j = 0; j < STATES; j++)
            LQ[i][j] = (float)B[i * STATES + j];
    factor(OBSERVATIONS, R, B);
    for (int i = 0; i < OBSERVATIONS; i++)
        for (int j = 0; j < OBSERVATIONS; j++)
            LR[i][j] = (float)B[i * OBSERVATIONS + j];
#else
    draw_noise(STATES, B, STATES, W);
    factor(OBSERVATIONS, R, B);
    draw_noise(OBSERVATIONS, B, 2 * STATES, V);
#endif
}

/* Point k is x minus the columns from k on, plus k - 1 times the column before. */
static void draw(void)
{
    for (int i = 0; i < STATES; i++) {
        const vector same = {x[i], x[i], x[i], x[i]};
        float sum = x[i];
        for (int word = (i + 1) / LANES; word < WORDS; word++)
            X[i].words[word] = same; /* columns beyond the factor's row */
        for (int j = i; j >= 0; j--) {
            const float term = coefficient[j] * L[i][j];
            X[i].numbers[j + 1] = sum + (float)(j + 1) * term;
            sum -= term;
        }
        X[i].numbers[0] = sum;
    }
}

#ifdef TRACED

#ifdef ADDITIVE
#define TERM(rows, i, k) 0.0f
#else
#define TERM(rows, i, k) rows[i].numbers[k]
#endif

static void propagate(const double *input)
{
    const float u[INPUTS] = {(float)input[0], (float)input[1], (float)input[2]};
    for (int k = 0; k < POINTS; k++) {
        float state[STATES], noise[STATES];
        for (int i = 0; i < STATES; i++) {
            state[i] = X[i].numbers[k];
            noise[i] = TERM(W, i, k);
        }
        MODEL_F(state, noise, u, state);
        for (int i = 0; i < STATES; i++)
            X[i].numbers[k] = state[i];
    }
}

static void observe(void)
{
    for (int k = 0; k < POINTS; k++) {
        float state[STATES], noise[OBSERVATIONS], result[OBSERVATIONS];
        for (int i = 0; i < STATES; i++)
            state[i] = X[i].numbers[k];
        for (int i = 0; i < OBSERVATIONS; i++)
            noise[i] = TERM(V, i, k);
        MODEL_H(state, noise, 0, result);
        for (int i = 0; i < OBSERVATIONS; i++)
            Z[i].numbers[k] = result[i];
    }
}

#else

#ifdef ADDITIVE
#define NOISE(rows, i, word) 0.0f
#else
#define NOISE(rows, i, word) rows[i].words[word]
#endif

static void propagate(const double *input)
{
    const float u1 = (float)input[0], u2 = (float)input[1], u3 = (float)input[2], half = dt / 2;
    for (int k = 0; k < WORDS; k++) {
        const vector q1 = X[0].words[k], q2 = X[1].words[k], q3 = X[2].words[k];
        const vector q0 = X[3].words[k];
        const vector r1 = u1 - X[4].words[k], r2 = u2 - X[5].words[k], r3 = u3 - X[6].words[k];
        X[0].words[k] += half * (q0 * r1 + q2 * r3 - q3 * r2) + dt * NOISE(W, 0, k);
        X[1].words[k] += half * (q0 * r2 + q3 * r1 - q1 * r3) + dt * NOISE(W, 1, k);
        X[2].words[k] += half * (q0 * r3 + q1 * r2 - q2 * r1) + dt * NOISE(W, 2, k);
        X[3].words[k] += dt * NOISE(W, 3, k) - half * (q1 * r1 + q2 * r2 + q3 * r3);
        for (int i = 4; i < STATES; i++)
            X[i].words[k] += dt * NOISE(W, i, k);
    }
}

static void observe(void)
{
    for (int k = 0; k < WORDS; k++) {
        const vector q1 = X[0].words[k], q2 = X[1].words[k], q3 = X[2].words[k];
        const vector q0 = X[3].words[k];
        const vector s1 = q1 * q1, s2 = q2 * q2, s3 = q3 * q3, s0 = q0 * q0;
        Z[0].words[k] = 2.0f * (q0 * q2 + q1 * q3) + NOISE(V, 0, k);
        Z[1].words[k] = 2.0f * (q2 * q3 - q0 * q1) + NOISE(V, 1, k);
        Z[2].words[k] = s0 - s1 - s2 + s3 + NOISE(V, 2, k);
        Z[3].words[k] = s0 + s1 - s2 - s3 + NOISE(V, 3, k);
        Z[4].words[k] = 2.0f * (q1 * q2 + q0 * q3) + NOISE(V, 4, k);
        Z[5].words[k] = 2.0f * (q1 * q3 - q0 * q2) + NOISE(V, 5, k);
    }
}

#endif

static inline float total(vector v) { return (v[0] + v[2]) + (v[1] + v[3]); }

/* Residuals of a row, in units of the root of the weight; gives the mean. */
static inline float reduce(const union points *points, union row *row)
{
    vector sum = points->words[0] * used.words[0];
    for (int k = 1; k < WORDS; k++)
        sum += points->words[k] * used.words[k];
    const float mean = total(sum) * root_weight;
    for (int k = 0; k < WORDS; k++)
        row->words[LEFT + k] = (points->words[k] - mean) * used.words[k];
    return mean;
}

/* Row j becomes a unit vector, and loses itself from the rows below; factors of states are kept. */
static inline int eliminate(int j, int begin, int end)
{
    vector q[COLUMNS], sum = E[j].words[begin] * E[j].words[begin];
    for (int k = begin + 1; k < end; k++)
        sum += E[j].words[k] * E[j].words[k];
    const float pivot = total(sum);
    if (!(pivot > 0.0f))
        return 1;
    const float root = sqrtf(pivot), inverse = 1.0f / root;
    for (int k = begin; k < end; k++)
        q[k] = E[j].words[k] * inverse;
    if (j < OBSERVATIONS)
        right[j] *= inverse;
    else
        L[j - OBSERVATIONS][j - OBSERVATIONS] = root;
    for (int i = j + 1; i < ROWS; i++) {
        sum = E[i].words[begin] * q[begin];
        for (int k = begin + 1; k < end; k++)
            sum += E[i].words[k] * q[k];
        const float l = total(sum);
        for (int k = begin; k < end; k++)
            E[i].words[k] -= l * q[k];
        if (j < OBSERVATIONS)
            right[i] -= l * right[j];
        else
            L[i - OBSERVATIONS][j - OBSERVATIONS] = l;
    }
    return 0;
}

static int iterate(const double *u, const double *z, double *estimate)
{
    MARK(SIG_GEN);
    draw();

    MARK(MODELS);
    propagate(u);

    MARK(PREDICT);
#ifdef ADDITIVE
    const vector none = {0};
    for (int i = 0; i < ROWS; i++)
        for (int k = 0; k < COLUMNS; k++)
            if (k < LEFT || k >= LEFT + WORDS)
                E[i].words[k] = none;
    for (int i = 0; i < STATES; i++)
        for (int j = 0; j <= i; j++)
            E[OBSERVATIONS + i].numbers[(LEFT + WORDS) * LANES + j] = LQ[i][j];
#endif
    for (int i = 0; i < STATES; i++)
        right[OBSERVATIONS + i] = -reduce(&X[i], &E[OBSERVATIONS + i]);

    MARK(MODELS);
    observe();

    MARK(UPDATE);
    for (int i = 0; i < OBSERVATIONS; i++)
        right[i] = (float)z[i] - reduce(&Z[i], &E[i]);
#ifdef ADDITIVE
    for (int i = 0; i < OBSERVATIONS; i++)
        for (int j = 0; j <= i; j++)
            E[i].numbers[LEFT * LANES - 1 - j] = LR[i][j];
    for (int j = 0; j < OBSERVATIONS; j++)
        if (eliminate(j, LEFT - 1 - j / LANES, LEFT + WORDS))
            return 1;
    for (int i = 0; i < STATES; i++)
        if (eliminate(OBSERVATIONS + i, 0, LEFT + WORDS + 1 + i / LANES))
            return 1;
#else
    for (int j = 0; j < ROWS; j++)
        if (eliminate(j, 0, COLUMNS))
            return 1;
#endif
    for (int i = 0; i < STATES; i++)
        x[i] = -right[OBSERVATIONS + i];
    MARK(OUTSIDE);

    for (int i = 0; i < STATES; i++)
        estimate[i] = (double)x[i];
    return 0;
}

#if defined(TRACED) && defined(ADDITIVE)
const struct filter traced_additive_filter = {"traced-additive", initialise, iterate};
#elif defined(TRACED)
const struct filter traced_filter = {"traced", initialise, iterate};
#elif defined(ADDITIVE)
const struct filter fast_additive_filter = {"fast-additive", initialise, iterate};
#else
const struct filter fast_filter = {"fast", initialise, iterate};
#endif
