"""The recursive prediction-error method: Gauss-Newton on the innovations, sample by sample.

riva2017_sensitivity_asrukf, eq. 7, with the factors of Theta and Delta carried in place of the matrices, and a gate for
each unknown. Ljung & Soderstrom, Theory and Practice of Recursive Identification (1983), ch. 3.
"""

from __future__ import annotations

import math

from noiseid_cli.filters.factors import update
from noiseid_cli.filters.gram_schmidt import upper_of_columns
from noiseid_cli.filters.linalg import backward_solve, forward_solve
from noiseid_cli.models.jit import routine


@routine
def adapt(theta, UT, UD, psi, e, observed, q, forgetting, is_open, A, L, US, stack, w):  # type: ignore[no-untyped-def]
    """One step: Delta, Sk, L, Theta, theta, in this order.

    Delta <- lambda Delta + (1 - lambda) e e', on the observed outputs; Sk = lambda Delta + psi Theta psi';
    L = Theta psi' Sk^-1 from the full psi, its rows zero where the gate is closed;
    Theta <- D (I - L psi) Theta (I - L psi)' D + L Delta L', D = 1 / sqrt(lambda) where open and 1 elsewhere: with
    forgetting running on behind a closed gate, Theta would grow by 1 / lambda at each sample and burst at the opening.

    Args:
        theta: (p,); UT: (p, p) upper factor of Theta; UD: (ny, ny) upper factor of Delta; all overwritten.
        psi: (>= q, p) dy^/dtheta, observed rows first; e: (>= q,) innovation.
        observed: (>= q,) indices of the observed outputs.
        forgetting: lambda, in (0, 1].
        is_open: (p,) above 0 where the gate is open.
        A, L: scratch (p, ny), (p, ny); US: scratch (ny, ny).
        stack, w: scratch (max(p, ny), width(p + ny)), (ny,).

    Returns:
        Whether Sk was regular; if not, theta and Theta stay as they are.
    """
    p, ny = theta.shape[0], UD.shape[0]
    root = math.sqrt(forgetting)
    for b in range(ny):
        w[b] = 0.0
    for b in range(q):
        for r in range(ny):
            UD[r, observed[b]] *= root
        w[observed[b]] = math.sqrt(1.0 - forgetting) * e[b]
    update(UD, ny, w)
    for b in range(q):
        for r in range(p):
            A[r, b] = 0.0
            for c in range(r, p):
                A[r, b] += UT[r, c] * psi[b, c]
            stack[b, ny + r] = A[r, b]
        for r in range(ny):
            stack[b, r] = root * UD[r, observed[b]]
    upper_of_columns(stack, q, ny + p, US)
    for b in range(q):
        if US[b, b] == 0.0:
            return False
    for j in range(p):
        for b in range(q):
            L[j, b] = 0.0
            if is_open[j] > 0.0:
                for r in range(j + 1):
                    L[j, b] += UT[r, j] * A[r, b]
        forward_solve(US, q, L[j])
        backward_solve(US, q, L[j])
        for b in range(q - 1, -1, -1):
            theta[j] += L[j, b] * e[b]
    for j in range(p):
        scale = 1.0 / root if is_open[j] > 0.0 else 1.0
        for r in range(p):
            total = UT[r, j] if r <= j else 0.0
            for b in range(q):
                total -= A[r, b] * L[j, b]
            stack[j, r] = scale * total
        for r in range(ny):
            total = 0.0
            for b in range(q):
                total += UD[r, observed[b]] * L[j, b]
            stack[j, p + r] = total
    upper_of_columns(stack, p, p + ny, UT)
    return True
