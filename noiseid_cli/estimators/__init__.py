"""Estimators of noise covariances: one algorithm, one file."""
