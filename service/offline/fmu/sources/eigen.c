/* Householder tridiagonalisation and the implicit QL method (Martin and Wilkinson; Bowdler, Martin,
   Reinsch and Wilkinson, Numerische Mathematik 11, 1968). */
#include "eigen.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define SWEEPS 60

static void tridiagonalise(int count, double *matrix, double *vectors, double *diagonal,
                           double *coupling, double *weight, double *image, double *normals)
{
    int i, j, k;

    memset(normals, 0, (size_t)count * count * sizeof *normals);
    memset(weight, 0, count * sizeof *weight);
    for (k = 0; k < count - 2; k++) {
        double *row = matrix + k * count, *normal = normals + k * count;
        double lead = row[k + 1], rest = 0.0, norm, projection = 0.0;
        diagonal[k] = row[k];
        for (i = k + 2; i < count; i++)
            rest += row[i] * row[i];
        if (rest == 0.0) {
            coupling[k] = lead;
            continue;
        }
        norm = -copysign(sqrt(lead * lead + rest), lead);
        coupling[k] = norm;
        for (i = k + 2; i < count; i++)
            normal[i] = row[i] / (lead - norm);
        normal[k + 1] = 1.0;
        weight[k] = (norm - lead) / norm;
        for (i = k + 1; i < count; i++) {
            double total = 0.0;
            for (j = 0; j < count; j++)
                total += matrix[i * count + j] * normal[j];
            image[i] = weight[k] * total;
            projection += image[i] * normal[i];
        }
        for (i = k + 1; i < count; i++)
            image[i] -= 0.5 * weight[k] * projection * normal[i];
        for (i = k + 1; i < count; i++)
            for (j = k + 1; j < count; j++)
                matrix[i * count + j] -= normal[i] * image[j] + image[i] * normal[j];
    }
    for (k = count > 2 ? count - 2 : 0; k < count; k++) {
        diagonal[k] = matrix[k * count + k];
        coupling[k] = k + 1 < count ? matrix[k * count + k + 1] : 0.0;
    }
    memset(vectors, 0, (size_t)count * count * sizeof *vectors);
    for (i = 0; i < count; i++)
        vectors[i * count + i] = 1.0;
    for (k = count - 3; k >= 0; k--) {
        const double *normal = normals + k * count;
        for (i = k + 1; i < count; i++) {
            double total = 0.0;
            for (j = 0; j < count; j++)
                total += vectors[i * count + j] * normal[j];
            for (j = 0; j < count; j++)
                vectors[i * count + j] -= weight[k] * total * normal[j];
        }
    }
}

static int diagonalise(int count, double *vectors, double *diagonal, double *coupling)
{
    int low, high, sweep, i, j;

    for (low = 0; low < count; low++) {
        for (sweep = 0;; sweep++) {
            double half, root, g, sine = 1.0, cosine = 1.0, carried = 0.0;
            int split = 0;
            for (high = low; high < count - 1; high++)
                if (!(fabs(coupling[high])
                      > DBL_EPSILON * (fabs(diagonal[high]) + fabs(diagonal[high + 1]))))
                    break;
            if (high == low)
                break;
            if (sweep == SWEEPS - 1)
                return 0;
            half = (diagonal[low + 1] - diagonal[low]) / (2.0 * coupling[low]);
            root = copysign(sqrt(half * half + 1.0), half);
            g = diagonal[high] - diagonal[low] + coupling[low] / (half + root);
            for (i = high - 1; i >= low; i--) {
                double f = sine * coupling[i], b = cosine * coupling[i], turn;
                double radius = sqrt(f * f + g * g);
                double *first = vectors + i * count, *second = first + count;
                coupling[i + 1] = radius;
                if (radius == 0.0) {
                    diagonal[i + 1] -= carried;
                    coupling[high] = 0.0;
                    split = 1;
                    break;
                }
                sine = f / radius;
                cosine = g / radius;
                g = diagonal[i + 1] - carried;
                turn = (diagonal[i] - g) * sine + 2.0 * cosine * b;
                carried = sine * turn;
                diagonal[i + 1] = g + carried;
                g = cosine * turn - b;
                for (j = 0; j < count; j++) {
                    double old = second[j];
                    second[j] = sine * first[j] + cosine * old;
                    first[j] = cosine * first[j] - sine * old;
                }
            }
            if (!split) {
                diagonal[low] -= carried;
                coupling[low] = g;
                coupling[high] = 0.0;
            }
        }
    }
    return 1;
}

int eigen_decompose(int count, double *matrix, double *vectors, double *values, double *work)
{
    double *coupling = work, *weight = work + count, *image = work + 2 * count;

    tridiagonalise(count, matrix, vectors, values, coupling, weight, image, work + 3 * count);
    return diagonalise(count, vectors, values, coupling);
}
