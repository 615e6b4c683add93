"""The Adept Cobra 600: program, records, checks, simulator and serial line."""
