"""What the Edit and History panels show, a module a section."""
