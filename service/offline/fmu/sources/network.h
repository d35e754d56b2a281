/* The thermal network: its numbers (model.c, generated), applied parameters, steps and slopes. */
#ifndef NETWORK_H
#define NETWORK_H

#include "laws.h"
#include "model.h" /* generated: NODES, EDGES, FILMS, ... */

#define SURROUNDINGS (2 + BOUNDARIES) /* the ambient, other boundaries, 1 W of losses */
#define ACTIVE (1 + FILMS)            /* temperatures that heats depend on */

/* A number that may be multiplied by a parameter; parameter -1 is none. */
typedef struct {
    double factor;
    int parameter;
} Coefficient;

typedef struct {
    int kind, first, second; /* second: NODES is the ambient, then the other boundaries */
    int input;               /* of the network's own inputs the one that drives a loss, or -1 */
    Coefficient coefficient[EDGE_COEFFICIENTS];
} Edge;

typedef struct {
    int node;
    Coefficient fraction; /* of what the shares before it have left */
} Share;

extern const Coefficient CAPACITY[];
extern const Edge EDGE[];
extern const Coefficient FRICTION[FRICTION_COEFFICIENTS];
extern const Share SHARE[];
extern const int BOUNDARY_INPUT[]; /* of the network's own inputs */

/* Speed in rpm, load in N, ambient in degC, then the network's own inputs. */
enum { SPEED_INPUT, LOAD_INPUT, AMBIENT_INPUT, FIRST_OWN_INPUT };
#define ALL_INPUTS (FIRST_OWN_INPUT + OWN_INPUTS)

/* Diagonal functions of one step length h: exp(-rate h), h phi1 and h phi2. */
typedef struct {
    double length, decay[NODES], first[NODES], second[NODES];
} StepFunctions;

/* A network with its parameters applied, at an operating point. */
typedef struct {
    double capacity[NODES], coefficient[EDGES][EDGE_COEFFICIENTS];
    double friction[FRICTION_COEFFICIENTS], share[NODES];
    int film_node[FILMS + 1];
    double film_law[FILMS + 1][2];
    double point[POINT_NUMBERS];
    double matrix[NODES][NODES], outside[SURROUNDINGS][NODES];
    /* T = sum of y[k] modes[k], y[k] = inverse[k] T */
    double rate[NODES], modes[NODES][NODES], inverse[NODES][NODES], source[ACTIVE][NODES];
    StepFunctions whole, half;
} Network;

/* The state that moves. */
typedef struct {
    double temperature[NODES]; /* degC */
    double revolutions;        /* since the grease was fresh */
    double step;               /* s, with which the last steps were taken */
    double coarse;             /* shortest steps in a row that were not exact enough */
} Motion;

void apply_parameters(Network *network, const double *parameter);

/* After a change of speed, load or an input that drives a loss. */
void apply_operating_point(Network *network, const double *input);

/* Modes of the operating point; gives 0 where there are none. */
int decompose(Network *network);

/* How a motion ended. */
enum { RUNS_AWAY, MOVED, TOO_FAST };

/* Moves by a time in s; the inputs stay. */
int move(Network *network, const double *input, double duration, Motion *motion);

/* Slopes of the temperatures in K/s. */
void slopes(const Network *network, const double *input, const Motion *motion, double *slope);

#endif
