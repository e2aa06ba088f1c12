"""What a run leaves to look at: one PNG and one HTML page (see `page.write_report`).

`recorder` is a sink that collects during a run; the rest draws when that is over.
"""
