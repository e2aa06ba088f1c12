"""What a run leaves to look at: one PNG and one HTML page (see `page.write_report`).

Made of the loop's results alone; matplotlib is loaded only when something is drawn.
"""
