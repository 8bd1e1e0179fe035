"""What jobs do: a function of `recordings`, or ``run`` of a module of their own: (arguments, workspace, progress) -> JSON values.

They run in processes of their own, see `job_process`, and call the public API.
"""
