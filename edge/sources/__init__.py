"""What yields observations: sensor messages joined by stamp, live or recorded."""
