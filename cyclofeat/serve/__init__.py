"""Local web page that drives the commands: recordings in; counts, gaps and their pages out.

=========  ====================================================================================
module     job
=========  ====================================================================================
``app``    routes, refusal of strangers; address, browser and end of the server
``jobs``   command lines for what the page asks, their processes, and the state of one server
``store``  private folder of uploads, and its bounds
``view``   words and tables for what the commands printed
=========  ====================================================================================

The page computes nothing: every answer is what ``cyclofeat inspect``, ``count``, ``gap`` or
``simulate`` prints with ``--json``, run as a process. So a job can be cancelled or die while the page lives,
and its errors are those of the command line.

Starlette and uvicorn (extra ``serve``) stream uploads, so that a bound is enforced while a file arrives.
"""

from cyclofeat.serve.app import make_app

__all__ = ["make_app"]
