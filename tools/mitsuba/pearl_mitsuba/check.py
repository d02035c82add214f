"""What must hold of a table's metadata (docs/LUT-FORMAT.md §7 to §13) before anything is computed from them."""

from numbers import Real

_MAX_AXIS_CELLS = 65536
_MAX_NODES = 65536
#: Largest interference colour.
_MAX_COLOUR = 1e6
#: Shares are sums of many roundings; beyond this it is not rounding any more.
_ROUNDING = 1e-6
_GAINS = 361


class Flaw(ValueError):
    """What is wrong, field first."""


def is_object(at, value):
    """A JSON object."""
    if not isinstance(value, dict):
        raise Flaw(f"{at}: is no JSON object")
    return value


def schema(meta):
    """Metadata whose schema can be read."""
    found = is_object("attribute pearl", meta).get("schema")
    if not isinstance(found, str):
        raise Flaw(f"schema: is {found!r}, expected pearl-lut/1")


def metadata(meta):
    """All that the plugin reads."""
    walked = _axis(_part(meta, "exit_axis"), meta.get("azimuth"))
    incidences = _list("per_incidence", meta.get("per_incidence"), 1, _MAX_AXIS_CELLS)
    before = -1.0
    for i, summary in enumerate(incidences):
        before = _incidence(f"per_incidence[{i}]", is_object(f"per_incidence[{i}]", summary), before, walked)
    _surface(_part(meta, "surface_model"))
    if "spectra" in meta:
        _spectra(_part(meta, "spectra"))
    if "reciprocal" in meta:
        _reciprocal(_part(meta, "reciprocal"), [summary["azimuth_width_deg"] for summary in incidences])


def _part(meta, key):
    if key not in meta:
        raise Flaw(f"{key}: is missing")
    return is_object(key, meta[key])


def _number(at, value, lo, hi, expected):
    if isinstance(value, bool) or not isinstance(value, Real) or not lo <= value <= hi:
        raise Flaw(f"{at}: is {value!r}, expected {expected}")
    return float(value)


def _list(at, value, fewest, most):
    if not isinstance(value, list):
        raise Flaw(f"{at}: is missing" if value is None else f"{at}: is no list")
    if not fewest <= len(value) <= most:
        expected = f"{fewest}" if fewest == most else f"{fewest} to {most}"
        raise Flaw(f"{at}: has {len(value)} entries, expected {expected}")
    return value


def _count(at, value, even):
    if isinstance(value, bool) or not isinstance(value, int) or not 2 <= value <= _MAX_AXIS_CELLS or (even and value % 2):
        raise Flaw(f"{at}: is {value!r}, expected an {'even ' if even else ''}whole number from 2 to {_MAX_AXIS_CELLS}")


def _axis(axis, azimuth):
    """Whether the table is one of the walk."""
    kinds = {"decay": "plane", "space": "space"}
    kind = axis.get("kind")
    if kind not in kinds.values() or azimuth not in kinds or kinds[azimuth] != kind:
        raise Flaw(f"exit_axis.kind: is {kind!r} with azimuth {azimuth!r}; decay goes with plane, space with space")
    _number("exit_axis.width", axis.get("width"), 1e-7, 0.5236, "1e-7 to π/6 radians")
    if kind == "plane":
        _count("exit_axis.cells", axis.get("cells"), even=True)
    else:
        _count("exit_axis.theta_cells", axis.get("theta_cells"), even=True)
        _count("exit_axis.phi_cells", axis.get("phi_cells"), even=False)
    return kind == "space"


def _incidence(at, summary, before, walked):
    """The angle, degrees."""
    theta = _number(f"{at}.theta_i_deg", summary.get("theta_i_deg"), 0.0, 90.0, "0 to 90")
    if theta <= before:
        raise Flaw(f"{at}.theta_i_deg: is {theta:g}, expected more than the entry before it")
    albedo, surface, rehit = (
        _number(f"{at}.{name}", summary.get(name), 0.0, 1.0 + _ROUNDING, "a share from 0 to 1")
        for name in ("albedo", "surface", "rehit")
    )
    for part, share, whole, most in (("surface", surface, "albedo", albedo), ("rehit", rehit, "surface", surface)):
        if share > most + _ROUNDING:
            raise Flaw(f"{at}.{part}: is {share:g}, expected at most {whole}, which is {most:g}")
    width = summary.get("azimuth_width_deg")
    if walked:
        _number(f"{at}.azimuth_width_deg", width, 0.0, 1e300, "a number ≥ 0")
    else:
        _number(f"{at}.azimuth_width_deg", width, 1e-6, 1e6, "a width in degrees from 1e-6 to 1e6")
    return theta


def _surface(model):
    for name in ("n_ambient", "n_first"):
        _number(f"surface_model.{name}", model.get(name), 1e-300, 1e300, "a positive number")
    _number("surface_model.slope_sd", model.get("slope_sd"), 0.0, 1e300, "a number ≥ 0")
    if model.get("normals") not in ("unweighted", "visible"):
        raise Flaw(f"surface_model.normals: is {model.get('normals')!r}, expected unweighted or visible")


def _ascending(at, nodes, lo, hi, expected):
    values = [_number(f"{at}[{i}]", node, lo, hi, expected) for i, node in enumerate(nodes)]
    for i, (a, b) in enumerate(zip(values, values[1:])):
        if b <= a:
            raise Flaw(f"{at}[{i + 1}]: is {b:g}, expected more than the entry before it, {a:g}")
    return values


def _spectra(section):
    at = "spectra.wavelength_nm"
    nm = _ascending(at, _list(at, section.get("wavelength_nm"), 1, _MAX_NODES), 1e-300, 1e300, "a positive wavelength")
    step = (nm[-1] - nm[0]) / max(len(nm) - 1, 1)
    for i, (a, b) in enumerate(zip(nm, nm[1:])):
        if abs(b - a - step) > 1e-3 * step:
            raise Flaw(f"{at}[{i + 1}]: is {b:g}, expected equally spaced bands")
    for name, key in (("coherent", "modulation"), ("emission", "radiance")):
        if name not in section:
            continue
        part = is_object(f"spectra.{name}", section[name])
        at = f"spectra.{name}.theta_deg"
        angles = _ascending(at, _list(at, part.get("theta_deg"), 2, _MAX_NODES), 0.0, 90.0, "an angle from 0 to 90")
        if angles[0] != 0.0 or angles[-1] != 90.0:
            raise Flaw(f"{at}: runs from {angles[0]:g} to {angles[-1]:g}, expected 0 to 90")
        for field, channels in ((key, len(nm)), (f"{key}_rgb", 3)):
            at = f"spectra.{name}.{field}"
            for i, row in enumerate(_list(at, part.get(field), len(angles), len(angles))):
                for k, value in enumerate(_list(f"{at}[{i}]", row, channels, channels)):
                    _number(f"{at}[{i}][{k}]", value, 0.0, _MAX_COLOUR, f"0 to {_MAX_COLOUR:g}")


def _reciprocal(section, widths):
    for name in ("interior_gain", "rehit_gain"):
        at = f"reciprocal.{name}"
        for i, gain in enumerate(_list(at, section.get(name), _GAINS, _GAINS)):
            _number(f"{at}[{i}]", gain, -1.0, 1.0, "a number from -1 to 1")
    for width in widths:
        if width != widths[0]:
            raise Flaw(f"reciprocal: needs one azimuth_width_deg at all incidences, found {widths[0]:g} and {width:g}")
