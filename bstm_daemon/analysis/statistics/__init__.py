"""Estimation from noisy series, for every room that reads recordings.

======================= =====================================================
:mod:`~.gls`            linear models: coast-down resistances, brake friction,
                        axle shares and cool-downs (``identify``)
:mod:`~.levenberg_marquardt`
                        non-linear models of few logarithms, many points at a
                        time: ``match``, and cooling while braking
:mod:`~.whitening`      covariance of thermocouple and force residuals, and
                        the drift that a set of residuals shows
:mod:`~.evidence`       Bayes factors of linear terms with nuisance
                        parameters integrated out (``gap``)
:mod:`~.resampling`     errors by leaving groups out or drawing them anew
:mod:`~.series`         runs, means and white noise of one series
======================= =====================================================
"""
