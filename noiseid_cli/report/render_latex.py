"""Tables as LaTeX for the booktabs package."""

from __future__ import annotations

from noiseid_cli.report.tables import Cell, Column, Missing, Table, plain, write_number

_SPECIALS = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%",
    "_": r"\_", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\textquotedbl{}", "`": r"\textasciigrave{}", "'": "'{}",
}  # fmt: skip
_SYMBOLS = {
    "–": "--", "—": "---", "−": "$-$", "×": r"$\times$", "·": r"$\cdot$", "²": "$^2$", "³": "$^3$", "±": r"$\pm$",
    "°": r"$^\circ$", "µ": r"$\mu$", "≤": r"$\le$", "≥": r"$\ge$", "→": r"$\to$", "√": r"$\surd$", "…": r"\dots{}",
    "Γ": r"$\Gamma$", "Δ": r"$\Delta$", "Θ": r"$\Theta$", "Σ": r"$\Sigma$", "Φ": r"$\Phi$", "Ω": r"$\Omega$",
    "α": r"$\alpha$", "β": r"$\beta$", "γ": r"$\gamma$", "δ": r"$\delta$", "ε": r"$\varepsilon$", "θ": r"$\theta$",
    "κ": r"$\kappa$", "λ": r"$\lambda$", "μ": r"$\mu$", "ν": r"$\nu$", "ρ": r"$\rho$", "σ": r"$\sigma$",
    "τ": r"$\tau$", "φ": r"$\varphi$", "ψ": r"$\psi$", "ω": r"$\omega$",
}  # fmt: skip


def latex_text(text: str) -> str:
    """Text that LaTeX sets as it is: no command, no comment, no ligature, no optional argument."""
    text = plain(text).replace("--", "-\0-").replace("--", "-\0-")
    out = "".join(_SPECIALS.get(c) or _SYMBOLS.get(c, c) for c in text).replace("\0", "{}")
    # A cell that starts so would be read as an option of the row's end before it.
    return "{}" + out if out.lstrip().startswith(("[", "*")) else out


def latex_table(table: Table) -> str:
    r"""A ``table`` environment with caption and label, to be \input; needs ``\usepackage{booktabs}``."""
    notes = table.notes()
    alignment = "".join("r" if table.numeric(j) else "l" for j in range(len(table.columns)))
    caption = " ".join(filter(None, [f"{table.title}.", table.caption]))
    lines = [
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{latex_text(caption)}}}",
        rf"  \label{{tab:{table.name}}}",
        rf"  \begin{{tabular}}{{{alignment}}}",
        r"    \toprule",
        _row([latex_text(column.title) for column in table.columns]),
        r"    \midrule",
    ]
    for row in table.rows:
        lines.append(_row([_cell(cell, column, notes) for cell, column in zip(row, table.columns, strict=True)]))
    lines += [r"    \bottomrule", r"  \end{tabular}"]
    lines += [rf"  \par\footnotesize $^{{{i}}}$ {latex_text(note)}." for i, note in enumerate(notes, 1)]
    return "\n".join([*lines, r"\end{table}", ""])


def _row(cells: list[str]) -> str:
    return "    " + " & ".join(cells) + r" \\"


def _cell(cell: Cell, column: Column, notes: list[str]) -> str:
    if isinstance(cell, Missing):
        return f"--$^{{{notes.index(cell.reason) + 1}}}$"
    if isinstance(cell, str):
        return latex_text(cell)
    written = write_number(cell, column)
    power = "" if written.exponent is None else rf" \times 10^{{{written.exponent}}}"
    return f"${written.digits}{power}$"
