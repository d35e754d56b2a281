/* Eigenvalues and eigenvectors of a small symmetric matrix. */
#ifndef EIGEN_H
#define EIGEN_H

/* Decomposes matrix (count x count, row by row), which is overwritten. Fills values, in no order,
   and vectors: row k is the eigenvector of value k. work has room for 3 count + count^2 numbers.
   Gives 0 where the iteration does not converge. */
int eigen_decompose(int count, double *matrix, double *vectors, double *values, double *work);

#endif
