"""The excitation monitor: sensitivities in units of their own maximum over the last samples.

riva2017_sensitivity_asrukf, eq. 9: |dx_n/dtheta_j| over its maximum in a window, summed over the states. A monotone
deque gives the sliding maximum in constant time on average (Lemire 2006).
"""

from __future__ import annotations

from noiseid_cli.models.jit import routine


@routine
def sliding_maximum(value, step, window, values, steps, ends):  # type: ignore[no-untyped-def]
    """Largest of the values of the last ``window`` steps, this one included.

    The deque holds, in a ring, the values that are larger than all later ones; the first is the maximum.

    Args:
        value: of this step, not negative.
        step: its number; it grows by 1 from call to call.
        window: number of steps, or 0 for all since the start.
        values, steps: the ring, (c,) f8 and (c,) int, c >= min(window, number of steps), or 1 for window 0.
        ends: (2,) int: place of the first entry, number of entries; zeros at the start.
    """
    c = values.shape[0]
    first, count = ends[0], ends[1]
    if window == 0:
        if count == 0 or value > values[0]:
            values[0] = value
        ends[1] = 1
        return values[0]
    if count > 0 and steps[first] <= step - window:
        first = first + 1 if first + 1 < c else 0
        count -= 1
    last = first + count - 1
    while count > 0 and values[last if last < c else last - c] <= value:
        last -= 1
        count -= 1
    at = first + count if first + count < c else first + count - c
    values[at], steps[at] = value, step
    ends[0], ends[1] = first, count + 1
    return values[first]


@routine
def excitation(sensitivity, step, window, values, steps, ends, out):  # type: ignore[no-untyped-def]
    """Sum over the states of each normalised sensitivity, between 0 and nx, written to out (p,).

    Args:
        sensitivity: (p, n) dx_n/dtheta_j.
        step, window: see ``sliding_maximum``.
        values, steps, ends: (p, n, c), (p, n, c), (p, n, 2), one deque for each sensitivity.
        out: (p,).
    """
    for j in range(sensitivity.shape[0]):
        out[j] = 0.0
        for i in range(sensitivity.shape[1]):
            size = abs(sensitivity[j, i])
            largest = sliding_maximum(size, step, window, values[j, i], steps[j, i], ends[j, i])
            if largest > 0.0:
                out[j] += size / largest
