"""A table exported as a nearest material, and how near its fit is: for glTF and for OpenPBR."""

import json

from built import run


def export(recipe, form, file):
    """Bakes a built-in recipe beside the file that it is exported to; the report of the export."""
    table = file.with_name("pearl.exr")
    run("bake-brdf", recipe, "--solver", "doubling", "--accuracy", 2, "-q", "-o", table)
    report = json.loads(run("lut", "export", table, "--to", form, "--json", "-o", file))
    errors = [(row["theta_i_deg"], round(row["error_percent"], 1)) for row in report["round_trip"]["per_incidence"]]
    print(report["round_trip"]["preview_delta_e"], report["material"], errors)
    return report


def check_near(report, error, colour):
    """Per cent of the light at 30°, and mean ΔE00 of the preview."""
    at = {row["theta_i_deg"]: row["error_percent"] for row in report["round_trip"]["per_incidence"]}
    assert at[30.0] < error and report["round_trip"]["preview_delta_e"]["mean"] < colour, report
