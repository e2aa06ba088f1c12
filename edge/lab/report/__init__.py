"""Reports of a run: one PNG and one HTML page (see `page.write_report`).

`recorder` is a sink that collects data during a run. The other modules draw after the run.
"""
