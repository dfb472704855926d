"""Signal measures of both channels: levels, spectra, response, travel."""
