"""The offline trusted party: it reads protocols on masks and writes what robots take on a mission."""
