/* What single parts of a network do: edges, losses, films, the friction heat. */
#ifndef LAWS_H
#define LAWS_H

/* Kinds of friction laws and of edges; the numbers are those of the model file's program. */
enum { PALMGREN, TWO_PART, LINEAR };
enum {
    CONSTANT, CONTACT, CONVECTIVE, CONVECTIVE_REFERENCE, FILM, SHAFT_SINK, SPEED_POWER,
    COPPER, POWER, SPEED_LOSS
};

#define EDGE_COEFFICIENTS 4
#define FRICTION_COEFFICIENTS 10
#define POINT_NUMBERS 5

/* Conductance in W/K at a speed >= 0 in rpm and a load >= 0 in N (a film: at its reference
   difference). That of a loss is what its heat loses per kelvin: below zero for copper, else 0. */
double edge_conductance(int kind, const double *c, double speed, double load, double driving);

/* Heat in W of a loss at 0 degC. */
double loss_at_zero_w(int kind, const double *c, double speed, double driving);

/* Fills point with everything of a friction law that does not change while speed and load stay. */
void friction_at_point(int kind, const double *c, double speed, double load, double *point);

/* Excess friction of fresh grease, as a part of what is left once it is run in. */
double running_in(int kind, const double *c, double revolutions);

/* Heat in W at the lubricant's temperature in degC; fresh is what running_in gave. */
double heat_at_point_w(int kind, const double *point, double temperature, double fresh);

/* Heat in W that a film takes up beyond its linear part, at a difference in K. */
double film_excess_w(double conductance, double exponent, double difference);

#endif
