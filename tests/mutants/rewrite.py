"""Rewrites Rust sources so that every mutant that `cargo mutants --list --json` names is there behind a number."""

import collections
import pathlib

import tree_sitter_rust
from tree_sitter import Language, Parser

PARSER = Parser(Language(tree_sitter_rust.language()))
COMPARISONS = ("==", "!=", "<", ">", "<=", ">=")
VERBATIM = ("token_tree", "line_comment", "block_comment", "attribute_item")


class Source:
    """One file and its mutants. Each place is wrapped in /*<K*/ ... /*K>*/ and each mutant in /*[K*/ ... /*K]*/,
    by which a compiler's error is traced to what it is about."""

    def __init__(self, name, text, mutants):
        self.text = text
        self.test = ("crate" if name.startswith("sitl") else "crpl_sitl") + "::mutant::is"
        self.placed = set()
        lines = text.split(b"\n")
        starts = [0]
        for line in lines:
            starts.append(starts[-1] + len(line) + 1)

        def offset(position):  # line and column from 1, in characters
            line = lines[position["line"] - 1].decode()
            return starts[position["line"] - 1] + len(line[: position["column"] - 1].encode())

        self.at = collections.defaultdict(list)
        for mutant in mutants:
            self.at[mutant["genre"], offset(mutant["span"]["start"])].append(mutant)
        self.bodies = sorted((start, found) for (genre, start), found in self.at.items() if genre == "FnValue")

    def rewritten(self):
        root = PARSER.parse(self.text).root_node
        return self.raw(0, root.start_byte) + self.emit(root) + self.raw(root.end_byte, len(self.text))

    def raw(self, start, end):
        return self.text[start:end].decode()

    def children(self, node, begin=None):
        """The node's text from `begin` on, its children rewritten."""
        at = node.start_byte if begin is None else begin
        out = []
        for child in node.children:
            if child.start_byte >= at:
                out += [self.raw(at, child.start_byte), self.emit(child)]
                at = child.end_byte
        return "".join([*out, self.raw(at, node.end_byte)])

    def emit(self, node):
        if node.type in VERBATIM or not node.children:
            return self.raw(node.start_byte, node.end_byte)
        special = getattr(self, node.type, None)
        return (special and special(node)) or self.children(node)

    def branch(self, mutant, text):
        self.placed.add(mutant["k"])
        return f"/*[{mutant['k']}*/{text}/*{mutant['k']}]*/"

    def choice(self, mutants, text, otherwise):
        """`otherwise`, or `text` of the mutant that is on."""
        tests = [f"if {self.test}({m['k']}) {{ {self.branch(m, text(m))} }} else " for m in mutants]
        return "".join(tests) + f"{{ {otherwise} }}"

    @staticmethod
    def wrapped(mutants, text):
        return f"/*<{mutants[0]['k']}*/{text}/*{mutants[0]['k']}>*/"

    def operands(self, node):
        left, operator, right = (node.child_by_field_name(part) for part in ("left", "operator", "right"))
        mutants = self.at.get(("BinaryOperator", operator.start_byte))
        return mutants and (mutants, self.emit(left), operator.text.decode(), self.emit(right))

    def binary_expression(self, node):
        if not (found := self.operands(node)):
            return None
        mutants, left, operator, right = found
        if operator in ("&&", "||"):  # the right side stays lazy
            either = self.choice(mutants, lambda m: f"l_ {m['replacement']} ({right})", f"l_ {operator} ({right})")
            return self.wrapped(mutants, f"({{ let l_ = {left}; {either} }})")
        either = self.choice(mutants, lambda m: f"l_ {m['replacement']} r_", f"l_ {operator} r_")
        if operator in COMPARISONS:  # which moves nothing
            return self.wrapped(mutants, f"(match (&({left}), &({right})) {{ (l_, r_) => {either} }})")
        return self.wrapped(mutants, f"({{ let l_ = {left}; let r_ = {right}; {either} }})")

    def compound_assignment_expr(self, node):
        if not (found := self.operands(node)):
            return None
        mutants, left, operator, right = found
        either = self.choice(mutants, lambda m: f"{left} {m['replacement']} r_", f"{left} {operator} r_")
        return self.wrapped(mutants, f"{{ let r_ = {right}; {either} }}")

    def unary_expression(self, node):
        mutants = self.at.get(("UnaryOperator", node.start_byte))
        if not mutants:
            return None
        either = self.choice(mutants, lambda _: "x_", f"{node.children[0].type}x_")
        return self.wrapped(mutants, f"({{ let x_ = {self.emit(node.children[1])}; {either} }})")

    def function_item(self, node):
        body, name = (node.child_by_field_name(part) for part in ("body", "name"))
        inside = [m for start, found in self.bodies if body and body.start_byte < start < body.end_byte for m in found]
        own = [m for m in inside if m["function"]["function_name"].split("::")[-1] == name.text.decode()]
        own = [m for m in own if m["k"] not in self.placed]
        if not own:
            return None
        returns = []
        for mutant in own:
            value = "" if mutant["replacement"] == "()" else mutant["replacement"]
            returns.append(f"if {self.test}({mutant['k']}) {{ {self.branch(mutant, f'return {value};')} }} ")
        return self.raw(node.start_byte, body.start_byte) + "{ " + "".join(returns) + self.children(body)[1:]

    def match_arm(self, node):
        pattern = node.child_by_field_name("pattern")
        guard = pattern.child_by_field_name("condition")
        gone = self.at.get(("MatchArm", node.start_byte), [])
        forced = self.at.get(("MatchArmGuard", guard.start_byte), []) if guard else []
        if not gone and not forced:
            return None
        test = f"({self.emit(guard)})" if guard else "true"
        for mutant in forced:
            on = f"{self.test}({mutant['k']})"
            test = f"({on} || {test})" if mutant["replacement"] == "true" else f"(!{on} && {test})"
            self.placed.add(mutant["k"])
        for mutant in gone:
            test = f"(!{self.test}({mutant['k']}) && {test})"
            self.placed.add(mutant["k"])
        if guard:
            shown = self.raw(pattern.start_byte, guard.start_byte) + test + self.raw(guard.end_byte, pattern.end_byte)
        else:
            shown = self.emit(pattern) + f" if {test} "
        return shown + self.children(node, pattern.end_byte)

    def field_initializer(self, node):
        mutants = self.at.get(("StructField", node.start_byte))
        if not mutants:
            return None
        name, value = (node.child_by_field_name(part) for part in ("field", "value"))
        shown = name.text.decode() if name else node.text.decode()
        base = next(child for child in node.parent.children if child.type == "base_field_initializer")
        rest = self.raw(base.start_byte + 2, base.end_byte)
        own = self.emit(value) if value else shown
        return self.wrapped(mutants, f"{shown}: " + self.choice(mutants, lambda _: f"({rest}).{shown}", own))

    shorthand_field_initializer = field_initializer


def rewrite(root, mutants, dropped):
    """Rewrites the files of `mutants` below `root`, but for those that are `dropped`; the numbers of those that found
    no place."""
    files = collections.defaultdict(list)
    for mutant in mutants:
        files[mutant["file"]].append(mutant)
    lost = []
    for name, found in files.items():
        path = pathlib.Path(root, name)
        kept = path.with_suffix(".rs.sound")
        if not kept.exists():
            kept.write_bytes(path.read_bytes())
        source = Source(name, kept.read_bytes(), [m for m in found if m["k"] not in dropped])
        path.write_text(source.rewritten())
        lost += [m["k"] for m in found if m["k"] not in dropped and m["k"] not in source.placed]
    return lost
