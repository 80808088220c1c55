"""A campaign runs many crossings in plain loops: points x directions x cases x laws x
estimators x plants x seeds.

- ``config``: what the campaign file says, checked; ``ranges``: limits of perturbations
  and bars; ``selection``: what the command line changes; ``rig``: the rig that the
  file names, and what it must offer.
- ``design``: the trials that follow from it, each with its key; ``trial``: one of them,
  run; ``self_calibration``: a robot that is calibrated by its own recordings first.
- ``pool``: worker processes, here or of a running Dask scheduler; ``worker``: what they
  call.
- ``rows``: what a trial gives; ``store``: the folder of rows, appended as they come;
  ``run``: all of it, with its progress; ``command``: from the command line, or one
  row again.
- ``summary``, ``report``, ``figure``, ``outcome``: statistics and bars, their tables,
  their picture, all in the folder.
"""
