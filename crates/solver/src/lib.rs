//! Least squares on manifolds: residuals, robust kernels, Levenberg-Marquardt, Schur elimination.
