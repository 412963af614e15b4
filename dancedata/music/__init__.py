"""Songs as samples: decoded, resampled, stretched."""
