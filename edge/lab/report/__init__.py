"""Report of a run for people: one PNG and one HTML page (see `page.write_report`).

`recorder` is a sink that collects a `record` during the run. All other modules draw after the run:
`page` is the HTML page, `picture` the map.
"""
