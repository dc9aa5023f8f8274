"""Compares a golden file with another making of it: numbers to a tolerance, the rest exactly."""

TOLERANCE = 1e-9
"""Relative. A difference that cancels to almost nothing may be off by 1e-6 of it, as in tests/src/golden.rs."""

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
    near = lambda case: abs(case["bits"] - bits) <= TOLERANCE * bits  # noqa: E731
    return file | {"cases": [case | {"outage": None} if near(case) else case for case in file["cases"]]}


def _split_flights(file):
    """The file with APC's flights cut to their tight part, and the whole flights of APC."""
    apc = [flight for flight in file["traces"] if flight["controller"] == "APC"]
    rest = [flight for flight in file["traces"] if flight["controller"] != "APC"]
    cut = [
        {key: x[:APC_STEPS] if isinstance(x, list) and key != "r_u" else x for key, x in flight.items() if key != "metrics"}
        for flight in apc
    ]
    return file | {"traces": rest + cut}, apc


def _loosely(got, want):
    for g, x in zip(got, want):
        name = f"APC {x['scenario']}"
        apart = max(abs(a - b) for p, q in zip(g["r"], x["r"]) for a, b in zip(p, q))
        if not apart <= 0.05:
            raise Difference(f"{name}: positions {apart:.3f} apart")
        if not abs(g["metrics"]["d_f"] - x["metrics"]["d_f"]) <= 0.02:
            raise Difference(f"{name}: d_f {g['metrics']['d_f']:.4f}, file {x['metrics']['d_f']:.4f}")


def file(got, want):
    """Compares two makings of a file; what to say of them if they agree. The definitions' words are free."""
    got, want = ({key: x for key, x in f.items() if key != "doc"} for f in (got, want))
    if "traces" in want:
        (got, apc_got), (want, apc_want) = _split_flights(got), _split_flights(want)
        off = worst(got, want)
        _loosely(apc_got, apc_want)
    elif any("bits" in case for case in want["cases"]):
        off = worst(_without_flags_on_the_threshold(got), _without_flags_on_the_threshold(want))
    else:
        off = worst(got, want)
    count = len(want.get("cases", want.get("traces", []))) + len(want.get("barrier_cases", []))
    return f"{count} cases, largest relative difference {off:.1e}"
