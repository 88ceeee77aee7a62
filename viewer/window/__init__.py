"""The window: a `Core` of state and commands, panels that draw from it, and a picture behind them."""
