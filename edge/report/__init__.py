"""What a run leaves to look at: one PNG and one HTML page (see `page.write_report`)."""
