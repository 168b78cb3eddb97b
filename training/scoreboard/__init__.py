"""The scoreboard: every agent on every task, and the page that shows how they did."""
