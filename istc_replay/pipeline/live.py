"""A replay that is watched while it is made: each window goes to Rerun's viewer as soon as it is solved."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import polars as pl

from istc_replay.errors import IstcReplayError
from istc_replay.export.rerun.spans import WHOLE
from istc_replay.export.rerun.view import Opening, new_recording, recording_id
from istc_replay.export.rerun.viewer import close_recording, connected, send_live, send_view
from istc_replay.windows import window_spans

if TYPE_CHECKING:
    import rerun as rr

    from istc_replay.config import Config
    from istc_replay.datatypes import Log, WindowOutcome
    from istc_replay.pipeline.reading import Reading

_SUFFIX = "-live"


class LiveView:
    """Streams the windows of one log after the other to a running viewer.

    While a log is being solved, a live recording of it grows; when its result is whole, the view
    of the result takes the live recording's place: the same as in view.rrd. A viewer that goes
    away does not stop the run: `lost` says why nothing is shown any more.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._recording: rr.RecordingStream | None = None
        self._anchor = WHOLE
        self.lost = ""

    def window(self, log: Log, config: Config, outcome: WindowOutcome) -> None:
        """Show one window of a log; `config` as settled for the log."""
        if self.lost:
            return
        from istc_replay.pipeline.assembly import assemble

        spans = window_spans(log, config)
        index = outcome.plan.scenario.window.index
        start, length = next((s, n) for s, n, i in spans if i == index)
        following = [s for s, _, _ in spans if s > start]
        cut = log.states.filter(pl.col("time_ns").is_between(start, start + length))
        part = assemble(replace(log, states=cut), config, [outcome]).result
        self._anchor = replace(
            self._anchor,
            origin_ns=spans[0][0],
            from_ns=start if start > spans[0][0] else None,
            until_ns=min(following, default=None),
            first_unit=index,
        )
        try:
            if self._recording is None:
                self._recording = connected(new_recording(part, _SUFFIX), self._url, Opening())
            self._anchor = send_live(part, config.view, self._anchor, self._recording)
        except IstcReplayError as error:
            self._lose(error)

    def finish(self, reading: Reading, config: Config) -> None:
        """Show the whole result in place of its windows."""
        self._end()
        if self.lost:
            return
        try:
            send_view(reading.result, config.view, self._url, Opening(), None, reading.parts)
            close_recording(self._url, recording_id(reading.result) + _SUFFIX)
        except IstcReplayError as error:
            self._lose(error)

    def _end(self) -> None:
        if self._recording is not None:
            self._recording.disconnect()
        self._recording, self._anchor = None, WHOLE

    def _lose(self, error: IstcReplayError) -> None:
        self.lost = str(error)
        self._end()
