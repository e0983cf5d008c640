"""Protocols as coroutines: requests for an exchange or a check, elements as bytes, the MAC check."""
