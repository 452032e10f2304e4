"""Running the catalogue of applications, judging it, and drawing its errors."""
