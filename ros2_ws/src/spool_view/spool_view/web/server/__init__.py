"""Server of the page: routes, streams of events, access control."""
