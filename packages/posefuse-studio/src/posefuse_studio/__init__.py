"""`posefuse studio`: a local browser page over the public API. Only `cli` imports it.

`app` serves the pages, `workspace` is the only place of files, `access` decides who may look, `jobs` runs long work in
processes of its own, `state` has what pages share and carries binary messages to them, `scene` draws them.
"""
