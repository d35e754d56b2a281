#include "laws.h"

#include <math.h>
#include <string.h>

/* Limits at and near standstill, and of a model that runs away. */
#define HEAT_LIMIT_W 3000.0
#define CONTACT_MIN_SPEED_RPM 10.0
#define CONTACT_MIN_LOAD_N 50.0
#define POWER_MIN_SPEED_RPM 10.0
#define REFERENCE_SPEED_RPM 3000.0
#define REFERENCE_LOAD_N 2650.0
#define LAW_MIN_FRACTION 0.1
#define COPPER_REFERENCE_C 20.0
#define FILM_REFERENCE_K 12.0
#define SHAFT_REFERENCE_RPM 6000.0
#define PALMGREN_BRANCH 7.600902459542082 /* ln 2000 */
#define PI 3.14159265358979323846

double edge_conductance(int kind, const double *c, double speed, double load, double driving)
{
    switch (kind) {
    case COPPER:
        return -c[0] * c[1] * driving * driving;
    case POWER:
    case SPEED_LOSS:
        return 0.0;
    case CONTACT:
        return 1.0 / (c[0] + c[1] + c[2] / sqrt(fmax(load, CONTACT_MIN_LOAD_N)
                                                 * fmax(speed, CONTACT_MIN_SPEED_RPM)));
    case CONVECTIVE:
        return (c[1] + c[2] * pow(speed, c[3])) / c[0];
    case CONVECTIVE_REFERENCE:
        return (c[1] + (c[2] - c[1]) * pow(speed / REFERENCE_SPEED_RPM, c[3])) / c[0];
    case FILM:
        return c[0];
    case SHAFT_SINK:
        return c[0] + c[1] * pow(speed / SHAFT_REFERENCE_RPM, 2.0 / 3.0);
    case SPEED_POWER:
        return 1.0 / (c[0] * pow(fmax(speed, POWER_MIN_SPEED_RPM) / c[1], c[2]));
    default:
        return 1.0 / c[0];
    }
}

double loss_at_zero_w(int kind, const double *c, double speed, double driving)
{
    if (kind == COPPER)
        return c[0] * (1.0 - c[1] * COPPER_REFERENCE_C) * driving * driving;
    if (kind == POWER)
        return copysign(c[0] * c[1] * pow(fabs(driving) / c[1], c[2]), driving);
    return c[0] * pow(speed / c[1], c[2]);
}

void friction_at_point(int kind, const double *c, double speed, double load, double *point)
{
    double relative_speed, relative_load;

    memset(point, 0, POINT_NUMBERS * sizeof *point);
    if (kind == LINEAR) {
        point[1] = c[0] * speed + c[1] * load + c[2];
        return;
    }
    point[0] = 1e-3 * 2.0 * PI / 60.0 * speed; /* W per N.mm */
    if (kind == PALMGREN) {
        point[1] = 0.0009 * pow(load / c[2], 0.55) * load * c[1];
        point[2] = log(fmax(c[3] * speed, 1e-12)) + c[4] * c[5];
        point[3] = c[4];
        point[4] = 1e-7 * c[0] * c[1] * c[1] * c[1];
        return;
    }
    relative_speed = log(fmax(speed / REFERENCE_SPEED_RPM, LAW_MIN_FRACTION));
    relative_load = log(fmax(load / REFERENCE_LOAD_N, LAW_MIN_FRACTION));
    point[1] = c[0] * (1.0 - c[5])
        * exp((c[1] + c[2] * relative_speed) * relative_speed + c[6] * relative_load);
    point[2] = c[3] + c[4] * relative_speed;
    point[3] = c[0] * c[5] * exp(c[7] * relative_load);
}

double running_in(int kind, const double *c, double revolutions)
{
    if (kind != TWO_PART || c[8] == 0.0)
        return 0.0;
    return c[8] * exp(-revolutions / c[9]);
}

double heat_at_point_w(int kind, const double *point, double temperature, double fresh)
{
    double moment;

    if (kind == LINEAR)
        return point[1];
    if (kind == PALMGREN) {
        double logarithm = point[2] - point[3] * temperature; /* of nu n */
        double viscous = logarithm >= PALMGREN_BRANCH ? exp(2.0 / 3.0 * logarithm) : 160.0;
        moment = point[1] + point[4] * viscous;
    } else {
        double viscosity = 989.0 / fmax(temperature + 95.0, 35.0) - 989.0 / 155.0;
        moment = (point[1] * exp(point[2] * viscosity) + point[3]) * (1.0 + fresh);
    }
    return fmin(point[0] * moment, HEAT_LIMIT_W);
}

double film_excess_w(double conductance, double exponent, double difference)
{
    double size = fabs(difference);

    if (size < 1e-9)
        return 0.0;
    return conductance * (pow(size / FILM_REFERENCE_K, exponent) - 1.0) * difference;
}
