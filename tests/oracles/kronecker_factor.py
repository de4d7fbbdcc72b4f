"""The derivative of a Cholesky factor as riva2017_sensitivity_asrukf (Table 1) has it: vec, Kronecker, elimination.

A_ls = (S (x) I + (I (x) S) N) E, with N the commutation matrix of S' and E the elimination matrix's transpose, takes
the stacked lower triangle of dS to vec(dP), for dP = dS S' + S dS'.
"""

import numpy as np


def kronecker_derivative(S, dP):
    """The lower-triangular dS that solves dS S' + S dS' = dP, as one dense linear system."""
    n = len(S)
    eye = np.eye(n)
    commutation = np.zeros((n * n, n * n))
    elimination = []
    for c in range(n):
        for r in range(n):
            commutation[r * n + c, c * n + r] = 1.0  # vec(M') = commutation vec(M), columns stacked
            if r >= c:
                elimination.append(np.eye(n * n)[:, c * n + r])
    E = np.array(elimination).T  # from the stacked lower triangle to vec
    A = (np.kron(S, eye) + np.kron(eye, S) @ commutation) @ E
    return (E @ np.linalg.lstsq(A, dP.ravel(order="F"), rcond=None)[0]).reshape((n, n), order="F")
