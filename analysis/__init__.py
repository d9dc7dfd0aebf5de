"""From radiance to BRDF samples, models, fits and a report."""
