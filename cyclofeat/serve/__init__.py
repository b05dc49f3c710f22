"""Local web page that drives the commands: recordings in; counts, gaps and their pages out.

=============  ===========================================================================
module         job
=============  ===========================================================================
``_app``       routes, and refusal of strangers
``_session``   what one server holds: model, recordings, jobs
``_store``     private folder of uploads, and its bounds
``_commands``  command lines for what the page asks
``_jobs``      commands in processes of their own
``_view``      words and tables for what the commands printed
``_running``   address, browser and end of the server
=============  ===========================================================================

The page computes nothing: every answer is what ``cyclofeat inspect``, ``count``, ``gap`` or
``simulate`` prints with ``--json``, run as a process. So a job can be cancelled or die while the page lives,
and its errors are those of the command line.

Built on starlette and uvicorn (extra ``serve``), which check types, stream uploads, so that a bound is
enforced while a file arrives, and are meant to stay up; Flask's own server is for development only. With
what they need they take 5 MB.
"""

from cyclofeat.serve._app import make_app
from cyclofeat.serve._running import Address, serve
from cyclofeat.serve._store import Limits

__all__ = ["Address", "Limits", "make_app", "serve"]
