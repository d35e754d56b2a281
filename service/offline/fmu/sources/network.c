/* Between two instants the network is linear but for the heats of friction and films:
   C dT/dt = -L T + g Ta + q. In the coordinates y = V' C^1/2 T, with C^-1/2 L C^-1/2 =
   V diag(rate) V', and for a q that is linear in time within a step h, the solution is exact:
   y1 = e y0 + h phi1 b0 + h phi2 (b1 - b0), b = V' C^-1/2 (g Ta + q). A predictor takes b1 = b0.
   Each step is taken as one and as two; the two results give the error and, extrapolated, the
   new state. */
#include "network.h"

#include <math.h>
#include <string.h>

#include "eigen.h"

#define TOLERANCE_K 1e-9
#define SHORTEST_STEP_S 1e-3
/* So many of them in a row that are not exact enough: no machine is so fast. */
#define MOST_COARSE_STEPS 1000
#define FIRST_STEP_S 0.25
#define TEMPERATURE_LIMIT_C 2000.0

static double applied(const Coefficient *coefficient, const double *parameter)
{
    if (coefficient->parameter < 0)
        return coefficient->factor;
    return coefficient->factor * parameter[coefficient->parameter];
}

void apply_parameters(Network *network, const double *parameter)
{
    double rest = 1.0;
    int e, i, j, films = 0;

    for (i = 0; i < NODES; i++)
        network->capacity[i] = applied(&CAPACITY[i], parameter);
    for (e = 0; e < EDGES; e++) {
        double *coefficient = network->coefficient[e];
        for (j = 0; j < EDGE_COEFFICIENTS; j++)
            coefficient[j] = applied(&EDGE[e].coefficient[j], parameter);
        if (EDGE[e].kind == FILM) {
            network->film_node[films] = EDGE[e].first;
            network->film_law[films][0] = coefficient[0];
            network->film_law[films++][1] = coefficient[1];
        }
    }
    for (j = 0; j < FRICTION_COEFFICIENTS; j++)
        network->friction[j] = applied(&FRICTION[j], parameter);
    memset(network->share, 0, sizeof network->share);
    for (j = 0; j < SHARES - 1; j++) {
        double fraction = applied(&SHARE[j].fraction, parameter);
        network->share[SHARE[j].node] += rest * fraction;
        rest *= 1.0 - fraction;
    }
    network->share[SHARE[SHARES - 1].node] += rest;
}

void apply_operating_point(Network *network, const double *input)
{
    double speed = fabs(input[SPEED_INPUT]), load = fmax(input[LOAD_INPUT], 0.0);
    int e;

    memset(network->matrix, 0, sizeof network->matrix);
    memset(network->outside, 0, sizeof network->outside);
    for (e = 0; e < EDGES; e++) {
        const Edge *edge = &EDGE[e];
        const double *coefficient = network->coefficient[e];
        double driving = edge->input < 0 ? 0.0 : input[FIRST_OWN_INPUT + edge->input];
        double conductance = edge_conductance(edge->kind, coefficient, speed, load, driving);
        int a = edge->first, b = edge->second;
        network->matrix[a][a] += conductance;
        if (edge->kind >= COPPER) {
            network->outside[1 + BOUNDARIES][a]
                += loss_at_zero_w(edge->kind, coefficient, speed, driving);
        } else if (b >= NODES) {
            network->outside[b - NODES][a] += conductance;
        } else {
            network->matrix[b][b] += conductance;
            network->matrix[a][b] -= conductance;
            network->matrix[b][a] -= conductance;
        }
    }
    friction_at_point(FRICTION_KIND, network->friction, speed, load, network->point);
}

/* Whether a node alone would follow its surroundings more slowly than another. */
static int slower(const Network *network, int first, int second)
{
    return network->matrix[first][first] / network->capacity[first]
        < network->matrix[second][second] / network->capacity[second];
}

int decompose(Network *network)
{
    double symmetric[NODES * NODES], vectors[NODES * NODES], work[(3 + NODES) * NODES];
    double root[NODES], total = 0.0;
    int order[NODES], i, j, k;

    for (i = 0; i < NODES; i++) {
        root[i] = sqrt(network->capacity[i]);
        for (k = i; k > 0 && slower(network, i, order[k - 1]); k--)
            order[k] = order[k - 1]; /* slow nodes first, as the method likes it */
        order[k] = i;
    }
    for (i = 0; i < NODES; i++)
        for (j = 0; j < NODES; j++) {
            int a = order[i], b = order[j];
            symmetric[i * NODES + j] = network->matrix[a][b] / (root[a] * root[b]);
            total += symmetric[i * NODES + j];
        }
    if (!isfinite(total) || !eigen_decompose(NODES, symmetric, vectors, network->rate, work))
        return 0;
    memset(network->source, 0, sizeof network->source);
    for (k = 0; k < NODES; k++) {
        if (!BOUNDLESS_RATES) /* rounding alone makes a rate negative */
            network->rate[k] = fmax(network->rate[k], 0.0);
        for (i = 0; i < NODES; i++)
            network->inverse[k][order[i]] = vectors[k * NODES + i] * root[order[i]];
        for (i = 0; i < NODES; i++) {
            network->modes[k][i] = network->inverse[k][i] / network->capacity[i];
            network->source[0][k] += network->modes[k][i] * network->share[i];
        }
        for (j = 0; j < FILMS; j++)
            network->source[1 + j][k] = -network->modes[k][network->film_node[j]];
    }
    network->whole.length = network->half.length = -1.0;
    return 1;
}

static void prepare(const double *rate, double length, StepFunctions *functions)
{
    int k;

    if (functions->length == length)
        return;
    functions->length = length;
    for (k = 0; k < NODES; k++) {
        double x = rate[k] * length;
        functions->decay[k] = exp(-x);
        if (fabs(x) < 0.02) { /* series: the closed forms lose all digits */
            double phi = 1.0 - x / 6.0 * (1.0 - x / 7.0);
            phi = 1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * phi));
            functions->second[k] = 0.5 * length * phi;
            functions->first[k] = length * (1.0 - 0.5 * x * phi);
        } else {
            double phi = (1.0 - functions->decay[k]) / x;
            functions->first[k] = length * phi;
            functions->second[k] = length * (1.0 - phi) / x;
        }
    }
}

/* Heats of friction and films at coordinates y. */
static void heats(const Network *network, const double *y, double ambient, double fresh,
                  double *heat)
{
    double lubricant = 0.0;
    int j, k;

    for (k = 0; k < NODES; k++)
        lubricant += network->modes[k][LUBRICANT_NODE] * y[k];
    heat[0] = heat_at_point_w(FRICTION_KIND, network->point, lubricant, fresh);
    for (j = 0; j < FILMS; j++) {
        const double *law = network->film_law[j];
        double difference = -ambient;
        for (k = 0; k < NODES; k++)
            difference -= network->source[1 + j][k] * y[k];
        heat[1 + j] = film_excess_w(law[0], law[1], difference);
    }
}

/* One step; steady is what acts on the coordinates from outside, fresh as at begin and end. */
static void take_step(const Network *network, const StepFunctions *functions,
                      const double *steady, double ambient, const double *fresh,
                      const double *y, double *result)
{
    double now[ACTIVE], later[ACTIVE];
    int j, k;

    heats(network, y, ambient, fresh[0], now);
    for (k = 0; k < NODES; k++) {
        double input = steady[k];
        for (j = 0; j < ACTIVE; j++)
            input += network->source[j][k] * now[j];
        result[k] = functions->decay[k] * y[k] + functions->first[k] * input;
    }
    heats(network, result, ambient, fresh[1], later);
    for (k = 0; k < NODES; k++) {
        double change = 0.0;
        for (j = 0; j < ACTIVE; j++)
            change += network->source[j][k] * (later[j] - now[j]);
        result[k] += functions->second[k] * change;
    }
}

/* Largest temperature that coordinates stand for; NaN where one is not finite. */
static double largest(const Network *network, const double *y)
{
    double result = 0.0;
    int i, k;

    for (i = 0; i < NODES; i++) {
        double total = 0.0;
        for (k = 0; k < NODES; k++)
            total += network->modes[k][i] * y[k];
        if (!isfinite(total))
            return NAN;
        result = fmax(result, fabs(total));
    }
    return result;
}

/* What ambient, other boundaries and losses do to the coordinates' slopes. */
static void from_outside(const Network *network, const double *input, double *steady)
{
    int b, i, k;

    for (k = 0; k < NODES; k++)
        steady[k] = 0.0;
    for (b = 0; b < SURROUNDINGS; b++) {
        double level = b == 0      ? input[AMBIENT_INPUT]
            : b <= BOUNDARIES ? input[FIRST_OWN_INPUT + BOUNDARY_INPUT[b - 1]]
                              : 1.0;
        for (k = 0; k < NODES; k++)
            for (i = 0; i < NODES; i++)
                steady[k] += network->modes[k][i] * network->outside[b][i] * level;
    }
}

int move(Network *network, const double *input, double duration, Motion *motion)
{
    double y[NODES], whole[NODES], middle[NODES], halves[NODES], difference[NODES];
    double steady[NODES], passed = 0.0, ambient = input[AMBIENT_INPUT];
    double per_second = fabs(input[SPEED_INPUT]) / 60.0;
    int i, k, part;

    for (k = 0; k < NODES; k++) {
        y[k] = 0.0;
        for (i = 0; i < NODES; i++)
            y[k] += network->inverse[k][i] * motion->temperature[i];
    }
    from_outside(network, input, steady);
    if (!(motion->step > 0.0))
        motion->step = FIRST_STEP_S;
    while (passed < duration) {
        double left = duration - passed, wanted = fmin(motion->step, left), error, factor;
        double length = left / ceil(left / wanted - 1e-9), fresh[3], both[2];
        for (part = 0; part < 3; part++)
            fresh[part] = running_in(FRICTION_KIND, network->friction,
                motion->revolutions + per_second * (passed + 0.5 * part * length));
        both[0] = fresh[0];
        both[1] = fresh[2];
        prepare(network->rate, length, &network->whole);
        prepare(network->rate, 0.5 * length, &network->half);
        take_step(network, &network->whole, steady, ambient, both, y, whole);
        take_step(network, &network->half, steady, ambient, fresh, y, middle);
        take_step(network, &network->half, steady, ambient, fresh + 1, middle, halves);
        for (k = 0; k < NODES; k++)
            difference[k] = (halves[k] - whole[k]) / 3.0;
        error = largest(network, difference);
        if (!isfinite(error))
            return RUNS_AWAY;
        factor = fmin(fmax(0.9 * cbrt(TOLERANCE_K / fmax(error, 1e-300)), 0.2), 4.0);
        if (error > TOLERANCE_K && length > SHORTEST_STEP_S) {
            motion->step = fmax(length * factor, SHORTEST_STEP_S);
            continue;
        }
        motion->coarse = error > TOLERANCE_K ? motion->coarse + 1.0 : 0.0;
        if (motion->coarse > MOST_COARSE_STEPS)
            return largest(network, y) < TEMPERATURE_LIMIT_C ? TOO_FAST : RUNS_AWAY;
        for (k = 0; k < NODES; k++)
            y[k] = halves[k] + difference[k];
        passed = length < left ? passed + length : duration;
        /* A step that the end of the time has cut says little of how long the next may be. */
        if (factor < 1.0 || length * factor > motion->step)
            motion->step = fmax(length * factor, SHORTEST_STEP_S);
    }
    for (i = 0; i < NODES; i++) {
        double total = 0.0;
        for (k = 0; k < NODES; k++)
            total += network->modes[k][i] * y[k];
        if (!isfinite(total) || (!BOUNDLESS_TEMPERATURES && fabs(total) >= TEMPERATURE_LIMIT_C))
            return RUNS_AWAY;
        motion->temperature[i] = total;
    }
    motion->revolutions += per_second * duration;
    return MOVED;
}

void slopes(const Network *network, const double *input, const Motion *motion, double *slope)
{
    const double *T = motion->temperature;
    double fresh = running_in(FRICTION_KIND, network->friction, motion->revolutions);
    double heat = heat_at_point_w(FRICTION_KIND, network->point, T[LUBRICANT_NODE], fresh);
    int b, e, i, j;

    for (i = 0; i < NODES; i++) {
        /* Differences, not L T: a huge conductance must not drown the balance in rounding. */
        slope[i] = network->share[i] * heat + network->outside[1 + BOUNDARIES][i];
        slope[i] -= network->outside[0][i] * (T[i] - input[AMBIENT_INPUT]);
        for (b = 0; b < BOUNDARIES; b++)
            slope[i] -= network->outside[1 + b][i]
                * (T[i] - input[FIRST_OWN_INPUT + BOUNDARY_INPUT[b]]);
        for (j = 0; j < NODES; j++)
            slope[i] += network->matrix[i][j] * (T[i] - T[j]);
    }
    for (e = 0; e < EDGES; e++)
        if (EDGE[e].kind == COPPER) {
            double driving = input[FIRST_OWN_INPUT + EDGE[e].input];
            i = EDGE[e].first;
            slope[i] -= T[i]
                * edge_conductance(COPPER, network->coefficient[e], 0.0, 0.0, driving);
        }
    for (j = 0; j < FILMS; j++) {
        const double *law = network->film_law[j];
        i = network->film_node[j];
        slope[i] -= film_excess_w(law[0], law[1], T[i] - input[AMBIENT_INPUT]);
    }
    for (i = 0; i < NODES; i++)
        slope[i] /= network->capacity[i];
}
