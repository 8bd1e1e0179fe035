"""What jobs do: one module per kind of work, each with ``run(arguments, workspace, progress) -> result`` of JSON values.

They run in processes of their own, see `job_process`, and call the public API.
"""
