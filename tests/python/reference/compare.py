"""Compares a golden file with another making of it: numbers to a tolerance, the rest exactly."""

TOLERANCE = 1e-9
"""Relative, to at least 1e-6: a difference that cancels keeps rounding errors (as in tests/src/golden.rs)."""

APC_STEPS = 19
"""Steps of APC's flights that are compared tightly: its search has ties (doc of closed_loop)."""


class Difference(Exception):
    """Where two files differ, and by what."""


def worst(got, want, path=""):
    """Largest relative difference of the numbers in two JSON values of the same shape."""
    if isinstance(want, dict):
        same = isinstance(got, dict) and got.keys() == want.keys()
        parts = [(got[key], want[key], f"{path}.{key}") for key in want] if same else None
    elif isinstance(want, list):
        same = isinstance(got, list) and len(got) == len(want)
        parts = [(g, x, f"{path}[{i}]") for i, (g, x) in enumerate(zip(got, want))] if same else None
    else:
        return _difference(got, want, path)
    if not same:
        raise Difference(f"{path} has another shape")
    return max((worst(*part) for part in parts), default=0.0)


def _difference(got, want, path):
    if isinstance(want, (bool, str)) or not isinstance(got, (int, float)):
        if got != want:
            raise Difference(f"{path}: reference {got}, file {want}")
        return 0.0
    off = abs(got - want) / max(abs(want), 1e-6)
    if not off <= TOLERANCE:
        raise Difference(f"{path}: reference {got!r}, file {want!r}, off by {off:.1e}")
    return off


def _without_flags_on_the_threshold(file):
    """On the threshold the last bit of a logarithm decides the flag; the bits are compared."""
    bits = file["params"]["L_pkt"]
    near = [abs(case["bits"] - bits) <= TOLERANCE * bits for case in file["cases"]]
    cases = [case | {"outage": None} if n else case for case, n in zip(file["cases"], near)]
    return file | {"cases": cases}


def _cut(flight):
    """The part of a flight that is compared tightly, if it is one of APC's."""
    if flight["controller"] != "APC":
        return flight
    kept = {key: x for key, x in flight.items() if key != "metrics"}
    return {key: x[:APC_STEPS] if isinstance(x, list) and key != "r_u" else x for key, x in kept.items()}


def _loosely(got, want):
    """The rest of APC's flights: positions to 0.05, d_f to 0.02."""
    for g, x in zip(got["traces"], want["traces"]):
        apart = max(abs(a - b) for p, q in zip(g["r"], x["r"]) for a, b in zip(p, q))
        d_f = g["metrics"]["d_f"], x["metrics"]["d_f"]
        if not (apart <= 0.05 and abs(d_f[0] - d_f[1]) <= 0.02):
            name = f"{x['controller']} in {x['scenario']}"
            raise Difference(f"{name}: positions {apart:.3f} apart, d_f {d_f[0]:.4f}, file {d_f[1]:.4f}")


def file(got, want):
    """Compares two makings of a file; what to say of them if they agree. The definitions' words are free."""
    got, want = ({key: x for key, x in f.items() if key != "doc"} for f in (got, want))
    if "traces" in want:
        cut = [made | {"traces": [_cut(flight) for flight in made["traces"]]} for made in (got, want)]
        off = worst(*cut)
        _loosely(got, want)
    elif any("bits" in case for case in want["cases"]):
        off = worst(_without_flags_on_the_threshold(got), _without_flags_on_the_threshold(want))
    else:
        off = worst(got, want)
    count = len(want.get("cases", want.get("traces", []))) + len(want.get("barrier_cases", []))
    return f"{count} cases, largest relative difference {off:.1e}"
