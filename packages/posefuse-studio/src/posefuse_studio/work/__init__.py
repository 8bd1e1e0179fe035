"""What jobs do: a function NAME_job of `recordings`, or ``run`` of a module: (arguments, workspace, progress) -> JSON values.

They run in processes of their own, see `job_process`, and call the public API.
"""
