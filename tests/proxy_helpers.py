"""A TCP forwarder between two robots that loses connections as a radio does."""

import contextlib
import socket
import threading


class Forwarder:
    """Forwards to a port of this machine; connection k breaks after ``limits[k]`` bytes of the caller.

    Until somebody listens there it takes connections and closes them, as a container's port proxy does.

    Args:
        target: The port to forward to.
        limits: One number a connection, or None for a connection that holds; later ones hold.
        gone: Whether nobody is reached any more after the limits are used up.
    """

    def __init__(self, target, limits, *, gone=False):
        self.target, self.limits, self.gone, self.count = target, list(limits), gone, 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._listener.close()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                caller, _ = self._listener.accept()
                peer = self._reach() if self.count < len(self.limits) or not self.gone else None
                if peer is None:
                    caller.close()
                    continue
                limit = self.limits[self.count] if self.count < len(self.limits) else None
                self.count += 1
                threading.Thread(target=self._serve, args=(caller, peer, limit), daemon=True).start()

    def _reach(self):
        with contextlib.suppress(OSError):
            return socket.create_connection(("127.0.0.1", self.target), timeout=5)
        return None

    def _serve(self, caller, peer, limit):
        back = threading.Thread(target=self._pump, args=(peer, caller, None), daemon=True)
        back.start()
        self._pump(caller, peer, limit)
        back.join(5)
        caller.close()
        peer.close()

    @staticmethod
    def _pump(source, sink, limit):
        with contextlib.suppress(OSError):
            while (limit is None or limit > 0) and (data := source.recv(4096)):
                data = data if limit is None else data[:limit]
                limit = None if limit is None else limit - len(data)
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
