"""One module a panel: each draws from the `Core` and posts what the user asks for."""
