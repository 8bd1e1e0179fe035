"""Many trials: every session below a folder, in processes of this machine or on a Dask cluster."""

from .study import Study, run_study
from .tasks import Trial, find_trials
