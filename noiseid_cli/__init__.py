"""noiseid: identify the noise covariances of a state-space model from recordings."""

__version__ = "0.1.0"
