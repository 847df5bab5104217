"""The language server, spoken to by pytest-lsp, a client that is not ours. ARMARIUM names the program."""

import os
import pathlib

import pytest
import pytest_lsp
from lsprotocol import types
from pytest_lsp import ClientServerConfig, LanguageClient

ROOT = pathlib.Path(__file__).resolve().parents[3]
WIPING = (ROOT / "statecharts" / "wiping.yaml").read_text()


@pytest_lsp.fixture(config=ClientServerConfig(server_command=[os.environ.get("ARMARIUM", "armarium"), "lsp"]))
async def client(lsp_client: LanguageClient, tmp_path: pathlib.Path):
    for file in (ROOT / "statecharts").glob("*.yaml"):
        (tmp_path / file.name).write_text(file.read_text())
    folder = types.WorkspaceFolder(uri=tmp_path.as_uri(), name="charts")
    await lsp_client.initialize_session(
        types.InitializeParams(
            capabilities=pytest_lsp.client_capabilities("visual-studio-code"), workspace_folders=[folder]
        )
    )
    lsp_client.folder = tmp_path
    yield
    await lsp_client.shutdown_session()


def opened(client, name, text):
    uri = (client.folder / name).as_uri()
    item = types.TextDocumentItem(uri=uri, language_id="yaml", version=1, text=text)
    client.text_document_did_open(types.DidOpenTextDocumentParams(text_document=item))
    return uri


async def diagnostics(client, uri):
    await client.wait_for_notification(types.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)
    while uri not in client.diagnostics:
        await client.wait_for_notification(types.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)
    return client.diagnostics[uri]


def place(text, needle, after=0):
    """The position of a text in another, in UTF-16 units."""
    before = text[: text.index(needle) + after]
    line = before.count("\n")
    return types.Position(line=line, character=len(before.split("\n")[-1].encode("utf-16-le")) // 2)


def at(uri, position):
    return {"text_document": types.TextDocumentIdentifier(uri=uri), "position": position}


@pytest.mark.asyncio
async def test_what_ships_is_in_order(client):
    assert not await diagnostics(client, opened(client, "wiping.yaml", WIPING))


@pytest.mark.asyncio
async def test_a_mistake_is_found_and_put_right(client):
    text = WIPING.replace("success: Keep", "success: Kepp")
    uri = opened(client, "wiping.yaml", text)
    (found,) = [d for d in await diagnostics(client, uri) if d.code == "E010"]
    assert found.range.start == place(text, "Kepp")
    actions = await client.text_document_code_action_async(
        types.CodeActionParams(
            text_document=types.TextDocumentIdentifier(uri=uri),
            range=found.range,
            context=types.CodeActionContext(diagnostics=[found]),
        )
    )
    (change,) = actions[0].edit.document_changes
    assert [edit.new_text for edit in change.edits] == ["Keep"]
    edit = types.TextDocumentContentChangePartial(range=change.edits[0].range, text="Keep")
    client.text_document_did_change(
        types.DidChangeTextDocumentParams(
            text_document=types.VersionedTextDocumentIdentifier(uri=uri, version=2), content_changes=[edit]
        )
    )
    assert not await diagnostics(client, uri)


@pytest.mark.asyncio
async def test_completion_hover_and_definition(client):
    uri = opened(client, "wiping.yaml", WIPING)
    targets = await client.text_document_completion_async(
        types.CompletionParams(**at(uri, place(WIPING, "success: Keep", len("success: "))))
    )
    items = targets if isinstance(targets, list) else targets.items
    assert {"Lift", "Keep", "Done"} <= {item.label for item in items}
    hover = await client.text_document_hover_async(types.HoverParams(**at(uri, place(WIPING, "ForceAdaptation"))))
    assert "skill **ForceAdaptation**" in hover.contents.value
    where = await client.text_document_definition_async(
        types.DefinitionParams(**at(uri, place(WIPING, "statechart: GraspObject", len("statechart: "))))
    )
    assert [location.uri for location in where] == [(client.folder / "grasp_object.yaml").as_uri()]


@pytest.mark.asyncio
async def test_a_state_is_renamed_in_chart_and_test(client):
    uri = opened(client, "wiping.yaml", WIPING)
    edit = await client.text_document_rename_async(
        types.RenameParams(**at(uri, place(WIPING, "  ByForce:", 2)), new_name="Guided")
    )
    files = {change.text_document.uri.rsplit("/", 1)[-1]: len(change.edits) for change in edit.document_changes}
    assert files == {"wiping.yaml": 3, "wiping.test.yaml": 3}
    with pytest.raises(Exception, match="is a skill"):
        await client.text_document_rename_async(
            types.RenameParams(**at(uri, place(WIPING, "ForceAdaptation")), new_name="Other")
        )


@pytest.mark.asyncio
async def test_form_symbols_and_lenses(client):
    uri = opened(client, "wiping.yaml", WIPING.replace("initial: Grasp\n", "initial: Grasp   \n\n\n\n", 1))
    document = types.TextDocumentIdentifier(uri=uri)
    options = types.FormattingOptions(tab_size=2, insert_spaces=True)
    (edit,) = await client.text_document_formatting_async(
        types.DocumentFormattingParams(text_document=document, options=options)
    )
    assert edit.new_text.strip() == ""
    symbols = await client.text_document_document_symbol_async(types.DocumentSymbolParams(text_document=document))
    states = next(symbol for symbol in symbols if symbol.name == "states")
    assert [state.name for state in states.children][:3] == ["Grasp", "Recall", "Learn"]
    lenses = await client.text_document_code_lens_async(types.CodeLensParams(text_document=document))
    assert [lens.command.command for lens in lenses] == ["armarium.run", "armarium.test", "armarium.graph"]
