"""Songs as samples: decoded, resampled, stretched; their levels."""
