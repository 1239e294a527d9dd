"""What only sweeps need is imported when it is used."""

from functools import partial

from pinmobile import extras

imported = partial(extras.imported, extra="sweeps", what="a sweep")
